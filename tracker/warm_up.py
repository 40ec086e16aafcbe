"""Compile the kernels that detection and tracking need, once per machine.

A second process compiles half of the kernels, so that two cores need half the time. If several processes
start at once, one compiles and the others wait for it.
"""

import contextlib
import fcntl
import functools
import gc
import logging
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import config
from numba.core.types import BaseFunction

from tracker.calibration.rig import CameraRig
from tracker.compiled import is_cached
from tracker.errors import TrackerError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.probability import probability_within
from tracker.objects.model import Box, load_object
from tracker.pose.agreement import disagreement
from tracker.pose.estimate import PoseEstimator
from tracker.pose.evidence import NUMBERS, judge
from tracker.pose.fit import Fit, OwnViews
from tracker.pose.refine import refine
from tracker.pose.views import PICTURE, Sight
from tracker.processes import python_command
from tracker.segmentation.color_model import load_colors
from tracker.segmentation.sensor import find_mosaic, noise_level
from tracker.tracking.motion import MotionFilter

_LOG = logging.getLogger(__name__)
_TURN = threading.Lock()
_SIZE = 64
_POSITION = np.array([0.0, 0.0, 0.0325])
KERNELS = 21
"""Number of machine code files that compilation produces."""

_THRESHOLDS = (100_000, 50, 100)
"""Thresholds of Python's garbage collection; without it, each process would need 200 MB more memory."""


def kernels_are_cached() -> bool:
    """Whether kernels are on disk (best effort); TrackerError if numba may not compile them."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        raise TrackerError("NUMBA_DISABLE_JIT: found it set, expected it unset: kernels must be compiled")
    return all(map(is_cached, (refine, so3.quaternion)))  # the last of each process


def kernel_folder() -> str | None:
    """Return the folder of compiled kernels, if any can be written or holds them."""
    path: str | None = getattr(refine.stats, "cache_path", None)
    return path


def warm_up() -> None:
    """Compile the kernels unless they are on disk, after a warning; later calls return at once."""
    if kernels_are_cached():
        return
    # Warnings reach standard error even if logging is not configured.
    often = "once per machine" if kernel_folder() else "which no folder can keep, see `tracker doctor`"
    _LOG.warning("compiling kernels, %s (about half a minute) ...", often)
    with _alone(), quickly(), _counted():
        if kernels_are_cached():
            return
        other = _begin()
        use_others()
        if other is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                other.wait(timeout=300)
        use_refinement()
    if kernel_folder() and not kernels_are_cached():
        _LOG.warning("the kernels could not be kept in %s: is the disk full?", kernel_folder())


@functools.cache
def load() -> None:
    """Load all kernels into this process, so that its first images take no longer than later ones."""
    warm_up()
    use_others()
    use_refinement()


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Let one thread at a time into the `with` block, of one process if there is a cache folder."""
    folder = kernel_folder()
    with _TURN, contextlib.ExitStack() as stack:
        if folder is not None:
            with contextlib.suppress(OSError):
                Path(folder).mkdir(parents=True, exist_ok=True)
                lock = stack.enter_context((Path(folder) / ".compiling").open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def _counted() -> Iterator[None]:
    """Show on a terminal how many kernels are on disk, including those of the other process."""
    folder = kernel_folder()
    if folder is None or sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    from tqdm import tqdm

    tqdm.monitor_interval = 0  # no monitor thread
    done = threading.Event()
    form = "compiled {n_fmt} of {total_fmt} kernels |{bar}| {elapsed}"
    with tqdm(total=KERNELS, bar_format=form, leave=False, file=sys.stderr) as bar:

        def follow() -> None:
            # Files of the present sources, beside each package or below NUMBA_CACHE_DIR.
            here = Path(folder)
            beside = f"*/{here.parent.name}/{here.name}/*.nbc"
            while not done.wait(0.3):
                kept = {*here.parents[2].glob(beside), *here.parents[1].glob(f"*/{here.name}/*.nbc")}
                bar.n = min(len(kept), KERNELS)
                bar.refresh()

        thread = threading.Thread(target=follow, daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


@contextlib.contextmanager
def quickly() -> Iterator[None]:
    """Cut compile time within the `with` block by a fifth.

    Garbage is collected less often: a compiler keeps most of its objects, and each collection scans them.
    The signature of an operator for given operand types is resolved once; numba would try dozens of
    signatures at each use.
    """
    before, resolve = gc.get_threshold(), BaseFunction.get_call_type
    known: dict[Any, Any] = {}

    def get_call_type(function: Any, context: Any, operands: Any, named: Any) -> Any:
        key = function, tuple(operands), tuple(named.items())
        if key in known:
            return known[key]
        signature = resolve(function, context, operands, named)
        if all(kind.is_precise() for kind in (*operands, *named.values())):
            known[key] = signature
        return signature

    gc.set_threshold(*_THRESHOLDS)
    BaseFunction.get_call_type = get_call_type  # type: ignore[assignment, method-assign]
    try:
        yield
    finally:
        gc.set_threshold(*before)
        BaseFunction.get_call_type = resolve  # type: ignore[method-assign]


def _begin() -> subprocess.Popen[bytes] | None:
    """Start a process that compiles `refine`; None if it cannot start, or has no folder for its results."""
    if kernel_folder() is None or not sys.executable:
        return None
    run = "from tracker.warm_up import quickly, use_refinement\nwith quickly(): use_refinement()"
    quiet = subprocess.DEVNULL
    with contextlib.suppress(OSError):
        return subprocess.Popen(python_command(run), stdin=quiet, stdout=quiet, stderr=quiet)
    return None


@functools.cache
def _estimator() -> PoseEstimator:
    """Return an estimator with one camera, shared by both parts."""
    transform = so3.transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.5])
    matrix = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera("above", _SIZE, _SIZE, matrix, np.zeros(5), transform)
    model = load_object("cube_v2")
    return PoseEstimator(Box.of(model), CameraRig((camera,)), load_colors(model.colors))


def _sight() -> Sight:
    """Return pictures with random labels, made without compiling the kernels that read pictures."""
    estimator, image = _estimator(), np.zeros((_SIZE, _SIZE, 3), np.uint8)
    labels = np.random.default_rng(0).integers(0, 7, estimator.reader.shape).astype(np.uint8)
    pictures = np.zeros(1, PICTURE)
    pictures["used"], pictures["address"] = True, image.__array_interface__["data"][0]
    pictures["height"], pictures["width"], pictures["mosaic"] = _SIZE, _SIZE, -1
    pictures["colored"] = np.count_nonzero(labels)
    return Sight(labels, pictures, (image,))


def use_others() -> None:
    """Compile or load all kernels but those of `use_refinement`."""
    estimator, sight, place = _estimator(), _sight(), (np.eye(3), _POSITION, np.zeros((1, 6)))
    image = np.random.default_rng(0).integers(0, 255, (_SIZE, _SIZE, 3)).astype(np.uint8)
    estimator.reader([image])
    # Called on their own for an image with a veil, and for one that may be frozen.
    find_mosaic(image)
    noise_level(image)
    positions = estimator.search.positions
    views = positions.views(sight.labels, sight.pictures)
    next(positions(views, sight.labels, sight.pictures, 1), None)
    first = estimator.search.begun(sight, _POSITION, range(1))[0]
    estimator.search.near(sight, [(first.rotation, first.position)])
    seen = estimator.search.counted(sight, np.eye(3), _POSITION)
    # The refinement judges fits, but takes long enough to compile without these two.
    estimator.search.resized(sight, Fit(_POSITION, np.eye(3), np.eye(6), seen, converged=True))
    maps, faces = estimator.search.lenses, estimator.search.faces
    judge(maps, sight.labels, sight.pictures, sight.pictures, faces, place, 0.0, seen, NUMBERS)
    nothing = OwnViews(np.zeros((1, 6, 6)), np.zeros((1, 6)), np.zeros(1))
    disagreement(nothing, maps, _POSITION, 0.05)
    covariance = 1e-8 * np.eye(6)
    motion = MotionFilter.start(np.zeros(3), np.eye(3), covariance).predicted(0.1)
    _ = motion.updated(np.zeros(3), np.eye(3), covariance).state
    probability_within(np.eye(6), 1.0, 1.0)
    so3.quaternion(np.eye(3))


def use_refinement() -> None:
    """Compile or load the kernels of the refinement; it takes about as long as the others together."""
    estimator, sight = _estimator(), _sight()
    fit = estimator.refiner(sight, np.eye(3), _POSITION)
    estimator.refiner.edges(sight.pictures, fit.rotation, fit.position)
