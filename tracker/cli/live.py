"""`tracker live`: track an object while cameras run."""

import contextlib
import functools
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import cv2

import tracker
from tracker.cli import options
from tracker.cli.live_outputs import LiveOutputs, Lookout, Requested, Statistics, check_cameras
from tracker.cli.options import Range, argument, command, flag, option
from tracker.cli.outputs import InFile, Recording
from tracker.cli.terminal import say
from tracker.errors import LiveError, message
from tracker.files import on_error
from tracker.live.sources import CAMERAS, FORMS, SIMULATION
from tracker.processes import Ended

_POSITIVE = Range(0, min_open=True)


@dataclass(frozen=True)
class Pace:
    """Options for a source's rate and settings. Each option applies to some sources only."""

    rate: float | None = option(
        "HZ", "Sets of images per second.  [default: 10]", Range(0, 1000, min_open=True)
    )
    settings: Path | None = option("FILE", "Settings of pylon's cameras (TOML, GenICam names).", InFile())
    speed: float | None = option("X", "Replay a recording X times as fast.", _POSITIVE)

    def refuse_what_does_nothing(self, source: str, cameras: options.Cameras) -> None:
        """Raise UsageError for options that have no effect on the source."""
        kind = source.partition(":")[0]
        recording = kind not in (*CAMERAS, SIMULATION)
        fitting = {"rate": kind in CAMERAS, "settings": kind == "pylon", "speed": recording}
        for name, value in vars(self).items():
            if value is not None and not fitting[name]:
                raise click.UsageError(f"--{name}: has no effect on the source {source}")
        if kind == SIMULATION != source:
            raise click.UsageError(f"{source}: expected simulation, without a name")
        if kind == SIMULATION and cameras.calibration:
            raise click.UsageError("--calibration: the simulation has its own, expected none")
        if kind in CAMERAS and not cameras.calibration:
            raise click.UsageError(f"{source}: expected --calibration")
        if kind in CAMERAS and cameras.resize_calibration:
            raise click.UsageError(
                f"--resize-calibration: found the cameras of {source}, whose images always have the "
                "calibration's size"
            )


@command()
def live(
    *,
    source: str = argument("SOURCE", Recording(str)),
    subject: options.Subject,
    cameras: options.Cameras,
    requested: Requested,
    seconds: float | None = option(
        "S", "Stop after S seconds.  [default: at the source's end, or with Ctrl-C]", _POSITIVE
    ),
    pace: Pace,
    check: bool = flag("Measure the cameras for ten seconds, and report their faults."),
    quiet: bool = flag("Print errors only."),
) -> None:
    """Track an object while cameras run.

    SOURCE is a recording's path, replayed at its own pace; `pylon`, Basler cameras that have the
    calibration's names, or `pylon:SERIAL,…` in its order; `opencv:0,1,2`, numbers, films or addresses; or
    `simulation`.

    A camera that fails is reopened when it is back; the others continue. --publish sends the filtered pose
    of the newest images: by ZeroMQ as JSON, by LCM (lcm://, udpm://ADDRESS:PORT?ttl=0, file://PATH) as
    dairlib's lcmt_object_state on the channel CUBE_STATE. docs/live.md describes the messages.

    --check does not track. It reports missing and late images, brightness, clipping and blur, and exits with
    1 if anything is wrong.
    """
    pace.refuse_what_does_nothing(source, cameras)
    if check and (requested or quiet):
        raise click.UsageError("--check: does not track, so there is nothing to publish, record or show")
    quiet = quiet or requested.as_json
    model, colors = subject.load()
    given, rig = _source(source, subject.object, cameras, pace)
    if check:
        with contextlib.closing(given):
            _draw(given, quiet)
            check_cameras(given, rig, seconds)
        return
    make_tracker = functools.partial(tracker.ObjectTracker, model, rig, colors)
    _track(source, given, make_tracker, requested, seconds, quiet)


def _track(
    name: str,
    given: tracker.live.ImageSource,
    make_tracker: Callable[[], tracker.ObjectTracker],
    requested: Requested,
    seconds: float | None,
    quiet: bool,
) -> None:
    """Track until the source ends, time is up, or a signal arrives; `name` is the source's name in errors."""
    with contextlib.ExitStack() as stack:
        with on_error(given.close):  # later, Live closes it
            finder = make_tracker()
            outputs = LiveOutputs(requested, given, finder, stack)
            _draw(given, quiet)
            other = make_tracker()
            statistics = Statistics()
            listeners = [statistics.hear, *outputs.listeners]
            follower = stack.enter_context(tracker.live.Live(given, other, listeners=listeners))
        if outputs.page is not None:
            outputs.page.faults = lambda: follower.faults
        lookout = Lookout(make_tracker)
        stopped = _follow(follower, seconds, outputs, lookout, None if quiet else statistics)
    outputs.tell()
    error = follower.error
    if error is not None:
        raise LiveError(f"{name}: {message(error)}") from error
    if not (quiet or isinstance(stopped, Ended)):
        left_out = getattr(given, "skipped", 0)
        click.echo(statistics.summary(left_out, [*follower.faults, *outputs.faults()], outputs.recorder))
    if not statistics.seen and stopped is None:
        raise LiveError(f"{name}: no camera ever gave an image that can be used")
    if not outputs.whole:
        raise click.exceptions.Exit(2)
    if stopped is not None:
        raise stopped


def _source(
    source: str, object_name: str, cameras: options.Cameras, pace: Pace
) -> tuple[tracker.live.ImageSource, tracker.CameraRig]:
    if source == SIMULATION:
        simulation = tracker.live.Simulation(object_name)
        return simulation, simulation.rig
    if source.partition(":")[0] in CAMERAS:
        if "OPENCV_LOG_LEVEL" not in os.environ:
            # It would warn each second of a camera that does not open. Before OpenCV 5, it is in cv2 itself.
            getattr(cv2.utils, "logging", cv2).setLogLevel(2)  # errors only
        rig = cameras.load()
        return tracker.live.open_cameras(source, rig, rate=pace.rate or 10.0, settings=pace.settings), rig
    if not Path(source).exists():
        raise LiveError(f"{source}: no such file or folder, expected {FORMS}")
    log = tracker.open_log(source)
    rig = cameras.rig_of(Path(source), log)
    return tracker.live.Replay(log, speed=pace.speed or 1.0), rig


def _draw(source: tracker.live.ImageSource, quiet: bool) -> None:
    """Render the simulation after all other checks; this time does not count towards --seconds."""
    if isinstance(source, tracker.live.Simulation):
        if not quiet:
            click.echo("drawing a film of the simulation, about ten seconds", err=True)
        source.draw()


def _follow(
    follower: tracker.live.Live,
    seconds: float | None,
    outputs: LiveOutputs,
    lookout: Lookout,
    statistics: Statistics | None,
) -> KeyboardInterrupt | None:
    """Print the statistics once per second, and faults immediately; return the interrupt that ended it."""
    end = None if seconds is None else time.monotonic() + seconds
    try:
        while follower.running:
            left = 1.0 if end is None else end - time.monotonic()
            if left <= 0:
                break
            time.sleep(min(left, 0.1))
            outputs.tell()
            if (swapped := lookout.look(follower.latest())) is not None:
                say(f"warning: {swapped}")
            if statistics is not None and (line := statistics.due()):
                click.echo(line)
    except KeyboardInterrupt as stop:
        return stop
    return None
