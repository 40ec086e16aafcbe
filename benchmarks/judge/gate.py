"""Compares a run with the committed baseline: no figure may fall by more than its tolerance."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measure.films import STRIDES
from benchmarks.score.records import Results, ResultsError
from benchmarks.score.summary import CHI2_MEDIAN
from tracker.files import write_whole

OVER_TIME = "over time"
"""Workload of the films' figures."""

BASELINE = Path(__file__).with_name("baseline.json")


def _identity(value: float) -> float:
    return value


def _dishonesty(nees: float) -> float:
    """How far a median NEES is from an honest one, by its factor either way."""
    return abs(math.log(max(nees, 1e-9) / CHI2_MEDIAN))


@dataclass(frozen=True)
class Tolerance:
    """By how much a figure may become worse: the greater of the two counts."""

    absolute: float
    relative: float = 0.0
    lower_is_worse: bool = False
    measure: Callable[[float], float] = _identity
    """What of the figure is compared."""

    def allows(self, before: float, now: float) -> bool:
        """Whether a figure may change that much; one that was measured must still be there."""
        if math.isnan(before):
            return True
        if math.isnan(now):
            return False
        old, new = self.measure(before), self.measure(now)
        loss = old - new if self.lower_is_worse else new - old
        return loss <= max(self.absolute, self.relative * abs(old)) + 1e-9


TOLERANCES: Mapping[str, Tolerance] = {
    # Errors: what a change of compiler or library may do to them.
    "median_position_mm": Tolerance(0.005, 0.10),
    "median_rotation_deg": Tolerance(0.01, 0.10),
    "p90_position_mm": Tolerance(0.02, 0.15),
    "p90_rotation_deg": Tolerance(0.04, 0.15),
    "median_roll_deg": Tolerance(0.02, 0.10),
    "median_mspd_px": Tolerance(0.01, 0.10),
    # Shares in per cent: one or two frames of a few hundred.
    "within_1": Tolerance(1.0, lower_is_worse=True),
    "within_5": Tolerance(0.5, lower_is_worse=True),
    "ar_mssd": Tolerance(0.5, lower_is_worse=True),
    "ar_mspd": Tolerance(0.5, lower_is_worse=True),
    "misses": Tolerance(0.5),
    "wrong_and_sure": Tolerance(0.3),
    "false_finds": Tolerance(0.0),
    # Honesty.
    "brier": Tolerance(0.005),
    "median_nees": Tolerance(0.2, measure=_dishonesty),
}
"""By the figure's name in the summary. What is not named is not held."""

ALIASES = {"median_mm": "median_position_mm", "median_deg": "median_rotation_deg"} | {
    "p90_mm": "p90_position_mm",
    "p90_deg": "p90_rotation_deg",
}
"""Names in the summary of figures that tolerances name in full."""

SPEED = Tolerance(0.1, 0.25)
"""Of the multiple of the reference work: milliseconds depend on the machine."""

DICE: Mapping[str, Tolerance] = {
    "mask_iou": Tolerance(0.005, lower_is_worse=True),
    "median_mm": Tolerance(0.05, 0.10),
    "p90_mm": Tolerance(0.1, 0.15),
    # Shares in per cent, of about five thousand dice.
    "found": Tolerance(0.5, lower_is_worse=True),
    "invented": Tolerance(0.3),
    "brier": Tolerance(0.005),
    "ratio": SPEED,
}
"""By the figure's name in those of the dice."""


FILMS: Mapping[str, Tolerance] = {
    # Shares in per cent, of the frames of two films, or of a few of them.
    "filtered": Tolerance(0.3, lower_is_worse=True),
    **{f"every_{stride}_filtered": Tolerance(1.0, lower_is_worse=True) for stride in STRIDES},
    **{f"every_{stride}_losses": Tolerance(0.0) for stride in STRIDES},
    "right_or_none": Tolerance(1.0, lower_is_worse=True),
    "flips": Tolerance(0.0),
    "kept": Tolerance(0.0),
    "invented": Tolerance(0.0),
    "longest_wait": Tolerance(1.0),
    "nees": TOLERANCES["median_nees"],
    **{f"{state}_ratio_{unit}": Tolerance(0.03) for state in ("rest", "moving") for unit in ("mm", "deg")},
    "ratio": SPEED,
}
"""By the figure's name in those of an object's films."""


def tolerance_of(name: str) -> Tolerance:
    """The tolerance of a figure as `held` names it.

    Raises:
        KeyError: it is none that is held.
    """
    workload, _, key = name.split(" / ")
    if workload == "speed" and key == "ratio":
        return SPEED
    return {"dice": DICE, OVER_TIME: FILMS}.get(workload, TOLERANCES)[key]


def held(results: Results) -> dict[str, float]:
    """The figures of a run that the gate looks at, by `workload / object / figure`."""
    figures = {}
    for workload, objects in results.get("summary", {}).items():
        for name, summary in objects.items():
            for key, value in summary.items():
                full = ALIASES.get(key, key)
                if full in TOLERANCES and isinstance(value, (int, float)):
                    figures[f"{workload} / {name} / {full}"] = float(value)
    for row in results.get("speed", {}).get("detect", ()):
        if row["images"] == "rendered":
            figures[f"speed / {row['object']} / ratio"] = float(row["ratio"])
    for key, value in results.get("dice", {}).get("figures", {}).items():
        if key in DICE and isinstance(value, (int, float)):
            figures[f"dice / thrown / {key}"] = float(value)
    for name, known in results.get("films", {}).get("figures", {}).items():
        for key, value in known.items():
            if key in FILMS and isinstance(value, (int, float)):
                figures[f"{OVER_TIME} / {name} / {key}"] = float(value)
    return figures


def failures(baseline: Mapping[str, Any], results: Results) -> tuple[list[str], list[str]]:
    """What has become worse than allowed, and what could not be compared, as sentences.

    Raises:
        ResultsError: the run was of other scenes than the baseline's.
    """
    about = results.get("about", {})
    for key in ("scenes", "seed"):
        if about.get(key) != baseline.get(key):
            raise ResultsError(
                f"results: found {key} {about.get(key)}, expected {baseline.get(key)} as in the baseline"
            )
    for part in ("dice", "films"):
        if results.get(part) and baseline.get(part) not in (None, results[part]["about"]):
            found = results[part]["about"]
            raise ResultsError(f"results: found {part} {found}, expected {baseline[part]} as in the baseline")
    now = held(results)
    worse: list[str] = []
    absent: list[str] = []
    for name, value in baseline["figures"].items():
        before = math.nan if value is None else float(value)
        workload = name.split(" / ")[0]
        if name not in now:
            reason = about.get("skipped", {}).get(workload)
            part = "films" if workload == OVER_TIME else workload
            skipped = reason is not None or (part in ("speed", "dice", "films") and not results.get(part))
            (absent if skipped else worse).append(
                f"{name}: not measured" + (f" ({reason})" if reason else "")
            )
            continue
        if not tolerance_of(name).allows(before, now[name]):
            worse.append(f"{name}: {now[name]:.4g}, was {before:.4g}")
    return worse, absent


def read_baseline(path: Path = BASELINE) -> dict[str, Any]:
    """The committed baseline.

    Raises:
        ResultsError: there is none.
    """
    try:
        result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path}: no baseline: {error}") from error
    return result


def write_baseline(results: Results, path: Path = BASELINE) -> None:
    """Make this run what later ones are compared with."""
    about = results.get("about", {})
    figures = {
        name: None if math.isnan(value) else float(f"{value:.5g}") for name, value in held(results).items()
    }
    content = {key: about.get(key) for key in ("commit", "processor", "seed", "scenes")}
    for part in ("dice", "films"):
        if results.get(part):
            content[part] = results[part]["about"]
    write_whole(path, json.dumps({**content, "figures": figures}, indent=1, ensure_ascii=False) + "\n")
