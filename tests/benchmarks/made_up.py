"""Answers of a run that never was, for tests of what is made from answers."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from click.testing import CliRunner

from benchmarks.data.store import packed, unpacked
from benchmarks.judge.results import Results
from benchmarks.program import main
from benchmarks.score.tables import BY_NAME

OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")

GROUPS = {"realistic": 0.1, "world": 1.0, "two cameras": 0.2, "one camera": 2.0, "hard light": 0.2}
"""Workloads and how large their errors are [mm]."""

MACHINE = {"processor": "one & only", "python": "3.11", "libraries": {"numpy": "2"}, "renderer": "raster"}

ABOUT: dict[str, Any] = {
    **{"commit": "0123abc", "clean": True, "code": "c0de", "kernels": "ce11", **MACHINE},
    **{"draw": "development", "seed": 1, "scenes": 30},
    "parts": {
        "accuracy": {"commit": "0123abc", "clean": True, "seconds": 90, **MACHINE, "skipped": {"a": "why"}}
    },
}


def assert_survives(one: Any) -> None:
    """What is written of a scene or frame is read again to the bit, and nothing of what is damaged."""
    kind, content = type(one), packed(one)
    np.testing.assert_equal(dataclasses.asdict(unpacked(kind, content)), dataclasses.asdict(one))
    assert unpacked(kind, content[: len(content) // 2]) is None
    assert unpacked(kind, content[:60] + bytes(9) + content[69:]) is None  # where compressed bytes begin


def printed_by(*arguments: object) -> str:
    """What a command of the benchmarks prints that has to go well."""
    done = CliRunner().invoke(main, list(map(str, arguments)), catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


def figures_of(rows: Any, table: str) -> list[dict[str, Any]]:
    """Rows of a table that are made of rows of answers."""
    return list(BY_NAME[table].figures(pd.DataFrame(rows)))


class Knowing:
    """A tracker that knows where an object is that goes along x at 1 m/s, but for `off` [m]."""

    def __init__(self, off: float = 0.0) -> None:
        self.off, self.resets = off, 0
        self.given: list[tuple[int, Any]] = []

    def reset(self) -> None:
        self.resets += 1

    def update(self, images: Any, timestamp: Any) -> SimpleNamespace:
        first = next(image for image in images if image is not None)
        self.given.append((int(first[0, 0, 0]), timestamp))
        pose, status = self.predict(float(np.max(timestamp))), SimpleNamespace(value="found")
        return SimpleNamespace(object_pose=pose, filtered_object_pose=None, status=status)

    def predict(self, timestamp: float) -> SimpleNamespace:
        position, orientation = np.array([timestamp, self.off, 0]), np.array([0, 0, 0, 1.0])
        return SimpleNamespace(position=position, orientation=orientation, covariance=1e-6 * np.eye(6))


def answer(**values: Any) -> dict[str, Any]:
    """A good answer to one scene, but for `values`."""
    good = {
        **{"group": "realistic", "object": "cube_v2", "index": 0, "pictures": 1.0, "visible": 0.8},
        **{"present": True, "status": "found", "found": True, "confidence": 0.98, "roll_deg": np.nan},
        **{"mm": 0.1, "deg": 0.1, "nees": 5.0, "ms": 2.0, "reference_ms": 1.0, "ratio": 2.0},
        **{"light_ms": 0.2, "segmentation_ms": 0.4, "pose_ms": 1.4},
    }
    none = dict.fromkeys(("confidence", "mm", "deg", "nees"), np.nan)
    return good | (none if values.get("found") is False else {}) | values


def answers(count: int, seed: int = 5) -> pd.DataFrame:
    """`count` answers to each workload and object, honest ones, and to scenes without the object."""
    rng, parts = np.random.default_rng(seed), []
    empty = {"present": False, "found": False, "status": "no_object_colors", "visible": 0.0}
    for name in OBJECTS:
        own = {"object": name, "index": range(count)}
        parts += [answer(**own, **empty, group=group) for group in ("absent", "look-alike: plain")]
        for group, scale in GROUPS.items():
            confidence = rng.beta(20, 1, count)
            right = rng.random(count) < confidence
            own |= {"group": group, "confidence": confidence, "visible": rng.uniform(0.3, 1, count)}
            for unit, off in (("mm", 30.0), ("deg", 90.0)):
                own[unit] = np.where(right, scale * rng.lognormal(0, 0.3, count), off)
            own |= {"nees": rng.chisquare(6, count), "ratio": rng.lognormal(0.7, 0.2, count)}
            parts.append(answer(**own, pictures=rng.normal(size=count)))
    return pd.concat(map(pd.DataFrame, parts), ignore_index=True)


def film(count: int = 10, **changed: Any) -> pd.DataFrame:
    """A film in which all is well."""
    fine = {
        **{"group": "all", "object": "cube_v2", "film": 0, "timestamp": np.arange(count) / 10},
        **{"present": True, "status": ["found", *["tracking"] * (count - 1)], "visible": 1.0, "found": True},
        **{"confidence": 0.99, "measured_given": True, "at_rest": np.arange(count) < count // 2},
        **{"mm": 0.05, "measured_mm": 0.1, "single_mm": 0.1, "deg": 0.1, "measured_deg": 0.2},
        **{"single_deg": 0.4, "nees": 5.0, "measured_nees": 5.0, "single_nees": 5.0},
        **{"ms": 0.8, "reference_ms": 1.0, "ratio": 0.8},
    }
    return pd.DataFrame({**fine, **changed})


def results(count: int = 30) -> Results:
    """Results with several parts."""
    own = [film(object=name, group=group) for name in OBJECTS for group in ("all", "world")]
    films = pd.concat(own, ignore_index=True)
    miss = {"group": "camera60", "px": 0.8, "miss_mm": 1.4, "shift_mm": 0.3, "turn_deg": 0.2}
    third = pd.DataFrame([{"object": name, **miss} for name in OBJECTS])
    return Results(dict(ABOUT), {"accuracy": answers(count), "films": films, "third camera": third})
