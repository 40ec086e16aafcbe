"""Open the target of a `Scene`: a file, or a viewer that only accepts connections from this machine."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from tracker.calibration.rig import CameraRig
from tracker.checks import naming
from tracker.errors import ImageError, TrackerError, install
from tracker.files import whole_file, writing
from tracker.objects.model import CuboidModel
from tracker.processes import environment, python_command

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from tracker.viz.rerun_scene import Scene

HOST = "127.0.0.1"
"""Address of the viewer, with a free port: Rerun's default port may belong to another user's viewer."""

_STARTING = 30.0  # longest time that the viewer may take to listen [s]
_SETTLING = 0.5
"""How long the viewer is watched after that [s]: without a screen it first listens, then exits."""

_open: list[subprocess.Popen[bytes]] = []
"""Viewers that were started; Python warns about a running process whose object is deleted."""


def require_rerun() -> None:
    """Raise TrackerError if the optional package `rerun-sdk` is missing."""
    if find_spec("rerun") is None:
        raise TrackerError(f"the view needs the package rerun-sdk: {install('rerun')}")


@contextmanager
def open_scene(path: str | os.PathLike[str] | None, rig: CameraRig, model: CuboidModel) -> Iterator[Scene]:
    """Yield a scene to show frames in; frames are written as they come, so that memory does not grow.

    The file at `path` (.rrd) appears complete when the `with` block ends. None opens a viewer.

    Raises:
        ImageError: the file cannot be written.
        TrackerError: the optional package `rerun-sdk` is missing, or the viewer cannot be opened.
    """
    require_rerun()
    # Errors are raised, so Rerun need not print them on stderr as well.
    with environment({"RUST_LOG": os.environ.get("RUST_LOG", "off")}):
        import rerun as rr

        from tracker.viz.rerun_scene import FLUSH_SECONDS, Scene, layout

    # Under this name, the viewer remembers the arrangement of its windows.
    stream = rr.RecordingStream("trifinger-object-tracker")
    if path is not None:
        with _file(stream, Path(path), layout(rig)):
            yield Scene(stream, rig, model)
        return
    with naming("the viewer cannot be reached", TrackerError, RuntimeError):
        stream.connect_grpc(start_viewer(), default_blueprint=layout(rig))
    with naming("the viewer is gone", TrackerError, RuntimeError), ExitStack() as ending:
        ending.callback(stream.disconnect)
        yield Scene(stream, rig, model)
        stream.flush(timeout_sec=FLUSH_SECONDS)


@contextmanager
def _file(stream: rr.RecordingStream, target: Path, blueprint: rrb.Blueprint) -> Iterator[None]:
    """Send the frames of the `with` block to a file, which appears when the block ends."""
    fault = naming(f"view {target}: cannot be written, is the disk full? ", ImageError, RuntimeError, sep="")
    with fault, writing(ImageError, f"view {target}"), whole_file(target) as temporary:
        temporary.write_bytes(b"")  # raises if it cannot be created; Rerun does not report the reason
        try:
            stream.save(temporary)  # with a blueprint, it may wait for ever if the disk is full
            stream.send_blueprint(blueprint, make_active=False)
            yield
            stream.flush(timeout_sec=30.0)
        finally:
            stream.disconnect()
        _check(temporary)


def _check(path: Path) -> None:
    """Raise an OSError if the table of contents, which Rerun writes last, is incomplete."""
    try:
        from rerun.chunk import RrdReader
    except ImportError:
        return  # older versions do not write one
    try:
        RrdReader(path).store()
    except ValueError as error:
        raise OSError(f"its end is missing: {error}") from error


def _command(port: int) -> list[str]:
    more = (f"--bind={HOST}", f"--port={port}", "--memory-limit=75%", "--expect-data-soon")
    return python_command("from rerun_cli.__main__ import main; sys.exit(main())", *more)


def start_viewer() -> str:
    """Start a viewer that outlives this process, and return its URL; TrackerError if it cannot be started.

    Rerun's own `spawn` makes it listen on all network interfaces, so that anyone could send images to it.
    """
    with socket.create_server((HOST, 0)) as one:
        port = one.getsockname()[1]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
        with naming("the viewer cannot be opened", TrackerError, OSError):
            nothing = subprocess.DEVNULL
            # In a session of its own, since Ctrl-C must not end the viewer.
            process = subprocess.Popen(
                _command(port), stdin=nothing, stdout=nothing, stderr=output, start_new_session=True
            )
        _open.append(process)
        end = time.monotonic() + _STARTING
        while process.poll() is None and time.monotonic() < end:
            if _answers(port):
                try:
                    process.wait(_SETTLING)
                except subprocess.TimeoutExpired:
                    return f"rerun+http://{HOST}:{port}/proxy"
            time.sleep(0.05)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)  # the whole group: the started process starts the viewer
            process.wait()
        output.seek(0)
        reason = (output.read().strip() or "it does not listen").splitlines()[-1].split(": ")[-1].rstrip(".")
    raise TrackerError(f"the viewer cannot be opened: {reason}; a file can be written instead (--rrd FILE)")


def _answers(port: int) -> bool:
    with socket.socket() as one:
        one.settimeout(1.0)
        return one.connect_ex((HOST, port)) == 0
