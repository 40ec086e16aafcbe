"""Compares results with a committed baseline: no figure may fall by more than its tolerance."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.judge.origin import origin
from benchmarks.judge.results import Results, ResultsError, contradictions
from benchmarks.toml_files import read_toml
from tracker.files import write_whole

BASELINE = Path(__file__).with_name("baseline.json")

TOLERANCES = Path(__file__).with_name("tolerances.toml")

HONEST_NEES = 5.348
"""Median of χ² with 6 degrees of freedom."""

ABOUT = ("draw", "seed", "scenes")
"""What results and baseline must have in common to be compared."""


@dataclass(frozen=True)
class Tolerance:
    """By how much a figure may become worse: the greater of the two counts."""

    absolute: float = 0.0
    relative: float = 0.0
    better: str = "lower"
    """`lower`, `higher`, or `honest`: as near to HONEST_NEES as can be, by its factor either way."""

    def allows(self, before: float, now: float) -> bool:
        """Whether a figure may change that much; one that was measured must still be there."""
        if math.isnan(before):
            return True
        if math.isnan(now):
            return False
        old, new = self._badness(before), self._badness(now)
        return new - old <= max(self.absolute, self.relative * abs(old)) + 1e-9

    def _badness(self, value: float) -> float:
        if self.better == "honest":
            return abs(math.log(max(value, 1e-9) / HONEST_NEES))
        return -value if self.better == "higher" else value


def tolerances() -> dict[str, dict[str, Tolerance]]:
    """By part and figure. What is not named is not held."""
    return {
        part: {figure: Tolerance(**values) for figure, values in figures.items()}
        for part, figures in read_toml(TOLERANCES).items()
    }


def held(results: Results) -> dict[str, float]:
    """The figures that are held, by `part / group / bin / object / figure`."""
    table, known = results.table, tolerances()
    wanted = [(part, figure) for part, figures in known.items() for figure in figures]
    own = table[[pair in wanted for pair in zip(table.part, table.figure, strict=True)]]
    keys = own[["part", "group", "bin", "object", "figure"]].agg(" / ".join, axis=1)
    return dict(zip(keys, own.value.astype(float), strict=True))


def failures(baseline: Mapping[str, Any], results: Results) -> list[str]:
    """What has become worse than allowed, or cannot be believed, as sentences.

    Raises:
        ResultsError: the results are of other scenes than the baseline's.
    """
    for key in ABOUT:
        if results.about.get(key) != baseline.get(key):
            raise ResultsError(
                f"results: found {key} {results.about.get(key)}, expected {baseline.get(key)} "
                "as in the baseline"
            )
    worse = [*doubts(results), *contradictions(results)]
    known, now = tolerances(), held(results)
    for name, value in baseline["figures"].items():
        part, *_, figure = name.split(" / ")
        if name not in now:
            worse.append(f"{name}: not measured")
        elif figure in known.get(part, {}) and not known[part][figure].allows(float(value), now[name]):
            worse.append(f"{name}: {now[name]:.4g}, was {float(value):.4g}")
    return worse


def doubts(results: Results) -> list[str]:
    """Why results say nothing of the code as it lies here: other sources, other kernels, parts left out."""
    here = origin()
    found = [
        f"{what}: the results are of {results.about.get(key)}, here it is {here[key]}; measure again"
        for key, what in (("code", "sources"), ("kernels", "compiled kernels"))
        if results.about.get(key) != here[key]
    ]
    missing = results.about.get("skipped", {})
    return found + [f"{name}: left out: {why}" for name, why in missing.items()]


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


def write_baseline(results: Results, reason: str, path: Path = BASELINE) -> None:
    """Make this run what later ones are compared with, and say why.

    Raises:
        ResultsError: as `check_origin`.
    """
    check_origin(results, reason)
    figures = {name: float(f"{value:.5g}") for name, value in held(results).items()}
    content = {key: results.about.get(key) for key in ("commit", "processor", *ABOUT)}
    content |= {"reason": reason.strip(), "figures": figures}
    write_whole(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def check_origin(results: Results, reason: str) -> None:
    """Whether results may become a baseline.

    Raises:
        ResultsError: there is no reason, or the results are not of a clean tree, or not of this one, or
            contradict themselves, or something was left out.
    """
    if not reason.strip():
        raise ResultsError("baseline: found no reason, expected one: say why it is replaced")
    if not results.about.get("clean") or not origin()["clean"]:
        raise ResultsError("baseline: the tree has changes that are not committed; commit them and measure")
    wrong = [*doubts(results), *contradictions(results)]
    if wrong:
        raise ResultsError(f"baseline: {wrong[0]}")
