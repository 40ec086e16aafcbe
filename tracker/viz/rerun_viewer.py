"""Opens what a `Scene` is sent to: a file, or a viewer on the screen."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from tracker.calibration.rig import CameraRig
from tracker.errors import ImageError, TrackerError, install
from tracker.files import whole_file
from tracker.objects.model import CuboidModel
from tracker.viz.viewer_process import viewer_address

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from tracker.viz.rerun_scene import Scene

APPLICATION = "trifinger-object-tracker"
"""Under this name the viewer remembers how its windows are arranged."""


def require_rerun() -> None:
    """Refuse where the optional package is missing.

    Raises:
        TrackerError: it is.
    """
    if find_spec("rerun") is None:
        raise TrackerError(f"the view needs the package rerun-sdk: {install('rerun')}")


@contextmanager
def open_scene(path: str | os.PathLike[str] | None, rig: CameraRig, model: CuboidModel) -> Iterator[Scene]:
    """A scene to show frames in; what it is sent is written as it comes, so memory does not grow.

    Args:
        path: the file, which ends in .rrd and appears whole when the `with` block ends, or not at all;
            None: a viewer is opened.
        rig: the cameras.
        model: the object.

    Raises:
        ImageError: the suffix is another, or the file cannot be written.
        TrackerError: the optional package `rerun-sdk` is missing, or the viewer cannot be opened.
    """
    target = None if path is None else Path(path)
    if target is not None and target.suffix.lower() != ".rrd":
        raise ImageError(f"view {target}: found suffix {target.suffix!r}, expected .rrd")
    require_rerun()
    with _silent():
        import rerun as rr

        from tracker.viz.rerun_scene import FLUSH_SECONDS, Scene, layout

    stream = rr.RecordingStream(APPLICATION)
    if target is not None:
        with _file(stream, target, layout(rig)):
            yield Scene(stream, rig, model)
        return
    try:
        stream.connect_grpc(viewer_address(), default_blueprint=layout(rig))
    except RuntimeError as error:
        raise TrackerError(f"the viewer cannot be reached: {error}") from error
    try:
        yield Scene(stream, rig, model)
        stream.flush(timeout_sec=FLUSH_SECONDS)
    except RuntimeError as error:
        raise TrackerError(f"the viewer is gone: {error}") from error
    finally:
        stream.disconnect()


@contextmanager
def _file(stream: rr.RecordingStream, target: Path, blueprint: rrb.Blueprint) -> Iterator[None]:
    """Send what is in the `with` block to a file, which appears when that ends."""
    try:
        with whole_file(target) as temporary:
            temporary.write_bytes(b"")  # whether a file can be there; Rerun does not say why not
            try:
                stream.save(temporary, default_blueprint=blueprint)
                yield
                stream.flush(timeout_sec=30.0)
            finally:
                stream.disconnect()
            _check(temporary)
    except OSError as error:
        raise ImageError(f"view {target}: cannot be written: {error.strerror or error}") from error
    except RuntimeError as error:
        raise ImageError(f"view {target}: cannot be written, is the disk full? {error}") from error


def _check(path: Path) -> None:
    """Raise an OSError where the table of contents, which Rerun writes last, is not whole."""
    try:
        from rerun.chunk import RrdReader
    except ImportError:
        return  # older versions write none
    try:
        RrdReader(path).store()
    except ValueError as error:
        raise OSError(f"its end is missing: {error}") from error


@contextmanager
def _silent() -> Iterator[None]:
    """While Rerun is imported: errors are raised, and need not be on stderr in its own words, too."""
    before = os.environ.get("RUST_LOG")
    os.environ["RUST_LOG"] = before or "off"
    try:
        yield
    finally:
        if before is None:
            del os.environ["RUST_LOG"]
        else:
            os.environ["RUST_LOG"] = before
