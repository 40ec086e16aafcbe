"""Which plots there are data for."""

from __future__ import annotations

from benchmarks.judge.results import Results
from benchmarks.report import accuracy_plots, speed_plots, trust_plots

BASE, BINS, CLEAN = "realistic", "occlusion bins", "clean"
EXACT, PERTURBED = "realistic", "perturbed calibration"


def plots_of(results: Results) -> dict[str, str]:
    """SVG elements by key."""
    frames = results.frames
    given = frames[frames.found & frames.present]
    base = frames[frames.workload.isin([BASE, BINS]) & frames.present]
    bounded = [name for name in (BASE, CLEAN) if (given.workload == name)[given.bound_mm.notna()].any()]
    sure = [name for name in (EXACT, PERTURBED) if (given.workload == name)[given.nees.notna()].any()]
    plots = {}
    if base.found.any():
        plots["visible"] = accuracy_plots.against_visible_fraction(base)
    if bounded:
        plots["bound"] = accuracy_plots.against_bound(given, bounded)
    if (given.workload == BASE).any():
        plots["cumulative"] = accuracy_plots.cumulative(frames, BASE)
    if frames.found.any():
        plots["reliability"] = trust_plots.reliability(frames[frames.found])
    if sure:
        plots["nees"] = trust_plots.nees(given, sure)
    times = {part: [row for row in results.rows if row["part"] == part] for part in speed_plots.PARTS}
    if times["time, stages"] and times["time"]:
        plots["stages"] = speed_plots.stages(times["time, stages"], times["time"])
    if all(times[f"time, {key}"] for key in ("cameras", "resolution", "faces")):
        plots["scaling"] = speed_plots.scaling(
            times["time, cameras"], times["time, resolution"], times["time, faces"]
        )
    return plots
