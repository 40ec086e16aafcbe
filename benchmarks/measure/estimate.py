"""How long a run will take, before it begins: what has to be rendered, and what has to be measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from benchmarks.data.dice import KINDS, dice_store
from benchmarks.data.films import FilmStore
from benchmarks.data.motion import FRAMES, motion_store
from benchmarks.data.package.environment import PackageError, interpreter
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.sets import BINS, PACKAGES, Plan, scene_set
from benchmarks.data.store import Store
from benchmarks.data.workloads import RIG, Workload
from benchmarks.measure.dice import dice_count
from benchmarks.measure.films import FILMS, STRIDES, film_length
from benchmarks.measure.motion import FILMS as MOTION_FILMS
from benchmarks.measure.motion import GIVEN
from benchmarks.measure.motion import film_length as motion_length

RENDER = {"scene": 1.1, "effect": 1.6, "rig": 1.0, "package": 2.5, "film": 1.1, "motion": 1.5, "dice": 1.6}
"""Processor time of one scene or frame, three cameras, on a core of a server [s]."""

ANSWER, BOUND, LOCATE, SPEED, RECORDED = 0.012, 0.04, 0.5, 300.0, 120.0
"""Of a detection with what belongs to it, of its bound, of a scene of dice; of all of speed, and of all
recorded pictures [s]."""


def estimate(
    plan: Plan, parts: Sequence[str], workloads: Sequence[Workload], objects: Iterable[str] | None
) -> float:
    """Seconds that parts will take on an otherwise idle machine; scenes that are kept cost nothing."""
    chosen = None if objects is None else set(objects)
    known: dict[str, Callable[[], float]] = {
        "speed": lambda: SPEED,
        "accuracy": lambda: _accuracy(plan, workloads, chosen),
        "recorded": lambda: RECORDED,
        "films": lambda: _films(plan),
        "motion": lambda: _motion(plan),
        "dice": lambda: _dice(plan),
    }
    return sum(known[part]() for part in parts if part in known)


def spoken(seconds: float) -> str:
    """For people."""
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _rendering(store: Store[Any], numbers: Iterable[int], kind: str, workers: int) -> float:
    return len(store.missing(numbers)) * RENDER[kind] / workers


def _accuracy(plan: Plan, workloads: Sequence[Workload], objects: set[str] | None) -> float:
    total = 0.0
    for name, base in {(name, w.base) for w in workloads for name in w.objects}:
        if objects is not None and name not in objects:
            continue
        own = [w for w in workloads if w.base == base and name in w.objects]
        count = plan.count("bins") * len(BINS) // 2 if base == "bins" else 0
        if base == "bins":  # which ones is known only when their sketches are there
            total += count * RENDER["scene"] / plan.workers
        elif base in PACKAGES and not _is_installed(plan):
            count = plan.count("package")
            total += count * RENDER["package"] / plan.workers
        else:
            scenes = scene_set(name, base, plan)
            count = len(scenes.numbers)
            total += _rendering(scenes.store, scenes.numbers, _kind(base), plan.workers)
        total += count * sum(ANSWER + BOUND * workload.bounded for workload in own)
    return total


def _is_installed(plan: Plan) -> bool:
    try:
        interpreter(plan.cache, install=False)
    except PackageError:
        return False
    return True


def _kind(base: str) -> str:
    if base.startswith(RIG):
        return "rig"
    return "package" if "package" in base else "effect" if "effect" in base or base == "world" else "scene"


def _films(plan: Plan) -> float:
    length, total = film_length(plan), 0.0
    for name in OBJECTS:
        store = FilmStore(name, length, plan.seed, plan.workers, plan.cache)
        numbers = store.prepared(range(FILMS))
        total += _rendering(store.store, numbers, "film", min(plan.workers, FILMS))
        total += FILMS * length * ANSWER * (2 + 3 + sum(1 / stride for stride in STRIDES))
    return total


def _motion(plan: Plan) -> float:
    total = 0.0
    for name in OBJECTS:
        store = motion_store(name, plan.seed, plan.workers, plan.cache)
        length = motion_length(plan)
        numbers = [film * FRAMES + frame for film in range(MOTION_FILMS) for frame in range(length)]
        total += _rendering(store, numbers, "motion", plan.workers)
        total += len(numbers) * len(GIVEN) * ANSWER
    return total


def _dice(plan: Plan) -> float:
    total = 0.0
    for kind in KINDS:
        numbers = range(dice_count(kind, plan))
        store = dice_store(kind, plan.seed, plan.workers, plan.cache)
        total += _rendering(store, numbers, "dice", plan.workers) + len(numbers) * LOCATE
    return total
