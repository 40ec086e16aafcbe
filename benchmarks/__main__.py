"""Measure the tracker: `python -m benchmarks [--quick] [--real FOLDER] [-o results.md]`."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

import click

from benchmarks.recorded import pose_table, segmentation_table
from benchmarks.rendered import SEED, accuracy_table
from benchmarks.speed import speed_table
from tracker.files import write_whole

ROOT = Path(__file__).resolve().parent.parent


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _commit() -> str:
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


@click.command()
@click.option("--quick", is_flag=True, help="Few scenes and draws: a smoke run, whose figures mean little.")
@click.option(
    "--real",
    type=click.Path(file_okay=False, path_type=Path),
    default=lambda: os.environ.get("TRACKER_REAL_DATA", ROOT.parent / "shared" / "real"),
    help="Folder of recorded data; left out where it is absent.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="File that gets the tables.")
def main(quick: bool, real: Path, output: Path | None) -> None:
    """Accuracy on rendered and recorded images, segmentation, robustness to light, speed."""
    scenes, draws = (12, 5) if quick else (300, 200)
    parts = [
        "# Results",
        f"Commit {_commit()}, {_processor()}, one thread. Written by `python -m benchmarks`.",
        "## Rendered scenes",
        f"{scenes} scenes an object (seed {SEED}, used for nothing else) with fingers, three cameras, "
        "270×270, exact calibration, realistic sensor with mosaic. Errors are of all poses given.",
        accuracy_table(scenes),
    ]
    recorded = Path(real) if Path(real).is_dir() else None
    if recorded is not None:
        parts += [
            "## Recorded triplets",
            f"Every labelled pixel's centre against the outline of its face; {draws} draws of gains 0.8-1.2 "
            "for each channel and exposure 0.6-1.4 for each image; same pose: within 3 mm and 3° of the "
            "undisturbed one.",
            pose_table(recorded, draws),
            "## Segmentation",
            "Intersection over union with hand-made masks over the whole image. The masks are drawn a "
            "little too small on purpose.",
            segmentation_table(recorded),
        ]
    parts += [
        "## Speed",
        "Warm, one thread, medians; reference work: `medianBlur` 5 and conversion to HSV of the same three "
        "images, in turn with the detection.",
        speed_table(recorded, *((4, 5) if quick else (20, 40))),
    ]
    text = "\n\n".join(parts) + "\n"
    click.echo(text)
    if output:
        write_whole(output, text)


if __name__ == "__main__":
    main()
