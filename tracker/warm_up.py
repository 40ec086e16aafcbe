"""Compile what detection and tracking need, once per machine: `python -m tracker.warm_up PART`.

Half of the kernels are compiled by a process of their own, so that two cores take half the time. Of several
processes that begin at once one compiles, and the others wait for it.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.compiled import is_cached
from tracker.geometry.camera import Camera
from tracker.geometry.probability import probability_within
from tracker.objects.box import Box
from tracker.objects.model import load_object
from tracker.pose.estimate import PoseEstimator
from tracker.pose.evidence import EvidenceReader
from tracker.pose.hypotheses import align
from tracker.pose.sight import Sight
from tracker.pose.solve.refine import settle
from tracker.segmentation.color_model import load_colors
from tracker.tracking.filter import MotionFilter

try:
    import fcntl
except ImportError:  # not on this operating system: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

_LOG = logging.getLogger(__name__)
_SIZE = 64
_SECONDS = 300


def kernels_are_cached() -> bool:
    """Whether compiled kernels lie on disk, so that the first detection starts at once (best effort)."""
    return is_cached(settle)


def warm_up() -> None:
    """Compile the kernels unless they lie on disk, and say so before; later calls return at once."""
    if kernels_are_cached():
        return
    # A warning reaches standard error without any set-up of logging.
    _LOG.warning("compiling kernels, once per machine (about half a minute) ...")
    with _alone():
        if kernels_are_cached():
            return
        other = _begin("solve")
        for part in ("search", "filter"):
            PARTS[part]()
        if other is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                other.wait(timeout=_SECONDS)
        PARTS["solve"]()


@functools.cache
def load() -> None:
    """Load what is compiled into this process, so that its first images take no longer than later ones."""
    warm_up()
    for part in PARTS.values():
        part()


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Wait until no other process is here; nothing is waited for where there is no place for machine code."""
    folder = getattr(settle.stats, "cache_path", None)
    if folder is None or fcntl is None:
        yield
        return
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        lock = (Path(folder) / ".compiling").open("w")
    except OSError:
        yield
        return
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _begin(part: str) -> subprocess.Popen[bytes] | None:
    """A process that compiles a part; None where it cannot be had, or could not hand on what it made."""
    if getattr(settle.stats, "cache_path", None) is None or not sys.executable:
        return None
    quiet = subprocess.DEVNULL
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "tracker.warm_up", part], stdin=quiet, stdout=quiet, stderr=quiet
        )
    except OSError:
        return None


def _estimator() -> tuple[PoseEstimator, Sight]:
    """An estimator, and noise for it to look at."""
    transform = np.eye(4)
    transform[:3, :3] = np.diag([1.0, -1.0, -1.0])
    transform[2, 3] = 0.5
    matrix = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera("above", _SIZE, _SIZE, matrix, np.zeros(5), transform)
    model = load_object("cube_v2")
    colors = load_colors(model.colors)
    estimator = PoseEstimator(Box.of(model), CameraRig((camera,)), colors.label_table)
    reader = EvidenceReader(colors, estimator.factors)
    image = np.random.default_rng(0).integers(0, 255, (_SIZE, _SIZE, 3)).astype(np.uint8)
    view = reader.read(reader.see(0, image), False)
    window = (1, 1, view.labels.shape[1], view.labels.shape[0])
    return estimator, estimator.sight([reader.glance(0, image, reader.lighting(image), window)])


def _search() -> None:
    estimator, sight = _estimator()
    integrals, _ = estimator.positions.integrals(sight.labels, sight.used)
    next(estimator.positions.positions(sight.labels, integrals, sight.used, 1), None)
    position = np.array([0.0, 0.0, 0.03])
    rotations, _ = estimator.rotations(sight.labels, sight.used, position, 2)
    align.try_hypotheses(
        estimator.small, sight.labels, sight.used, estimator.box.half, estimator.box.face_labels,
        rotations, np.repeat(position[None], 2, axis=0), np.array([3, 2]), np.empty(2),
    )  # fmt: skip


def _solve() -> None:
    estimator, sight = _estimator()
    estimator.refine(sight, np.eye(3), np.array([0.0, 0.0, 0.0325]))


def _filter() -> None:
    covariance = 1e-8 * np.eye(6)
    motion = MotionFilter.start(np.zeros(3), np.eye(3), covariance).predicted(0.1)
    _ = motion.updated(np.zeros(3), np.eye(3), covariance).state
    probability_within(np.eye(6), 1.0, 1.0)


PARTS: dict[str, Callable[[], None]] = {"search": _search, "solve": _solve, "filter": _filter}

if __name__ == "__main__":
    PARTS[sys.argv[1]]()
