"""Outputs of `tracker live`: printed lines, and receivers of poses."""

import math
import select
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

import tracker
from tracker.cli.options import file_option, flag, option
from tracker.cli.outputs import refuse_overwriting
from tracker.cli.terminal import listing, say, table
from tracker.live import ImageSource, Moment
from tracker.live.camera_check import look_at
from tracker.live.listeners import Listener, Recorder, RerunView
from tracker.live.publishers import LcmPublisher, Publisher, ZmqPublisher, is_lcm, message_of
from tracker.live.web_page import WebPage
from tracker.summaries.remarks import swapped
from tracker.summaries.summary import SURE


@dataclass(frozen=True)
class Requested:
    """Options for receivers of poses; UsageError if one needs another, or they exclude each other."""

    addresses: Sequence[str] = option(
        "ADDRESS",
        "Publish poses: tcp://127.0.0.1:5555 by ZeroMQ, lcm:// by LCM. May be given several times.",
        name="--publish",
        multiple=True,
    )
    public: bool = flag("Let other machines receive what is published.")
    body: str | None = option(
        "NAME", "Name of the object in LCM messages.  [default: cube, of another shape cuboid]"
    )
    record: Path | None = file_option("Record images and poses (.h5).", ".h5", ".hdf5")
    view: bool = flag("Show images and poses in the viewer Rerun.")
    rrd: Path | None = file_option("Write what --view shows into a file (.rrd).", ".rrd")
    page: int | None = option(
        "PORT",
        "Show images, pose and cameras in a browser on this machine, http://127.0.0.1:PORT.",
        click.IntRange(0, 65535),
    )
    as_json: bool = flag("Print each message as it is published.", name="--json")

    def __bool__(self) -> bool:
        return any((self.addresses, self.record, self.view, self.rrd, self.page is not None, self.as_json))

    def __post_init__(self) -> None:
        if self.public and not self.addresses:
            raise click.UsageError("--public: expected with --publish")
        if self.body is not None and not any(map(is_lcm, self.addresses)):
            raise click.UsageError("--body: expected with --publish lcm://")
        if self.view and self.rrd:
            raise click.UsageError("--view: found with --rrd, expected one or the other")
        files = {"--record": self.record, "--rrd": self.rrd}
        logs = {f"--publish {one}": Path(one[7:]) for one in self.addresses if one.startswith("file://")}
        refuse_overwriting({name: path for name, path in (files | logs).items() if path}, ())


class LiveOutputs:
    """The requested outputs, opened; the stack closes them. `listeners` are called with each moment."""

    def __init__(
        self, requested: Requested, source: ImageSource, finder: tracker.ObjectTracker, stack: ExitStack
    ) -> None:
        rig, model = finder.rig, finder.model
        self.recorder: Recorder | None = None
        self.listeners: list[Callable[[Moment], None]] = []
        self.page: WebPage | None = None
        self._fallible: dict[Listener | Publisher, str] = {}
        self._told: set[Listener | Publisher] = set()
        self._files: list[Listener] = []
        self._unprinted: OSError | None = None

        def print_message(moment: Moment) -> None:
            try:
                if select.select([], [sys.stdout], [], 0)[1]:  # a stalled reader holds up nothing
                    click.echo(message_of(moment).decode())
            except OSError as error:  # `tell` raises it, since nobody sees what this thread raises
                self._unprinted = error

        def add(output: Listener | Publisher, name: str = "") -> None:
            stack.callback(output.close)
            self.listeners.append(output)
            self._fallible[output] = name and f"the {name} has ended: "

        if requested.record is not None:
            self.recorder = Recorder(requested.record, rig, lambda: getattr(source, "settings", ()))
            add(self.recorder, "recording")
            self._files.append(self.recorder)
        for address in requested.addresses:
            if is_lcm(address):
                add(LcmPublisher(address, model, body=requested.body, public=requested.public))
            else:
                add(ZmqPublisher(address, public=requested.public))
        if requested.view or requested.rrd:
            view = RerunView(requested.rrd, rig, model)
            add(view, "view")
            self._files += [view] if requested.rrd else []
        if requested.page is not None:
            self.page = WebPage(requested.page, finder)
            add(self.page, "page")
            click.echo(f"page: {self.page.address}", err=True)
        if requested.as_json:
            self.listeners.append(print_message)

    @property
    def whole(self) -> bool:
        """Whether everything could be written to the files."""
        return not any(one.fault for one in self._files)

    def faults(self) -> list[str]:
        """Return the messages of outputs that ended or failed, except the recorder."""
        failed = ((one, what) for one, what in self._fallible.items() if one.fault)
        return [f"{what}{one.fault}" for one, what in failed if one is not self.recorder]

    def tell(self) -> None:
        """Report each output that has ended or failed once, on stderr; raise the error of stdout."""
        if self._unprinted is not None:
            raise self._unprinted
        for one, what in self._fallible.items():
            if one.fault and one not in self._told:
                self._told.add(one)
                say(f"{what}{one.fault}")


_SILENT = 10  # after so many lines, one per second, without images, print nothing until the next image

_NEVER = "never found: check the object, its colours and the calibration; --check measures the cameras"

_STAMPS = ""
"""Key of faults in all cameras' timestamps, among faults by camera name; no camera's name is empty."""


class Statistics:
    """Counts moments in the tracking thread from now on; another thread prints the counts."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._statuses: Counter[str] = Counter()
        self._faults: Counter[str] = Counter()
        self._reasons: dict[str, str] = {}
        self._posed = False
        self.seen = False  # whether any set has had an image
        self._latencies: deque[float] = deque(maxlen=100_000)  # for percentiles
        self._newest: Moment | None = None
        self._told_count, self._told_faults = 0, Counter[str]()
        self._told_at = self._begin = time.monotonic()
        self._silent = 0  # consecutive lines without images

    def hear(self, moment: Moment) -> None:
        """Count a moment; a listener of `Live`."""
        faults = {**moment.faults, **({} if moment.jump is None else {_STAMPS: moment.jump})}
        with self._lock:
            self._newest = moment
            self._statuses[moment.status.value] += 1
            self._latencies.append(moment.latency)
            self._posed |= moment.object_pose is not None
            self.seen |= any(image is not None for image in moment.taken.images)
            self._faults.update(faults.keys())
            self._reasons.update(faults)

    def due(self) -> str | None:
        """Return a line about the last second once it has passed; None after ten seconds without images."""
        now = time.monotonic()
        passed = now - self._told_at
        if passed < 1.0:
            return None
        with self._lock:
            count, moment = self._statuses.total(), self._newest
            faults, reasons = self._faults.copy(), dict(self._reasons)
        sets, lately = count - self._told_count, faults - self._told_faults
        self._told_at, self._told_count, self._told_faults = now, count, faults
        self._silent = 0 if sets else self._silent + 1
        if self._silent > _SILENT:
            return None
        if self._silent == _SILENT:
            return f"{now - self._begin:7.1f} s  no images for ten seconds; waiting for the next"
        parts = [f"{now - self._begin:7.1f} s", f"{sets / passed:5.1f} Hz"]
        if moment is None:
            return "  ".join([*parts, "no images yet"])
        parts.append(f"{moment.status.value:10}")
        pose = moment.filtered_object_pose
        if pose is not None:
            place = " ".join(f"{1000 * value:7.1f}" for value in pose.position)
            parts.append(f"{place} mm  confidence {pose.confidence:.2f}")
        parts.append(f"latency {1000 * moment.latency:.1f} ms")
        recent = [f"{name or 'stamps'}: {reasons[name]} ({n} of {sets} sets)" for name, n in lately.items()]
        return "  ".join([*parts, *recent])

    def summary(self, left_out: int, faults: Sequence[str], recorder: Recorder | None = None) -> str:
        """Return the final summary."""
        count = self._statuses.total()
        rows = [["sets of images", f"{count}, {left_out} skipped"]]
        if count:
            shares = [f"{name} {100 * n / count:.1f} %" for name, n in self._statuses.most_common()]
            median, late = np.percentile(1e3 * np.array(self._latencies), [50, 99])
            rows.append(["status", ", ".join(shares)])
            if not self._posed:
                rows.append(["", _NEVER if self.seen else "no camera ever gave an image"])
            rows.append(["latency", f"median {median:.1f} ms, 99th percentile {late:.1f} ms"])
        cameras = () if self._newest is None else self._newest.fault_counts  # in their order
        for name in dict.fromkeys((_STAMPS, *cameras, *self._faults)):
            if times := self._faults[name]:
                text = f"faulty in {times} of {count} sets; last: {self._reasons[name]}"
                rows.append([name or "stamps", text])
        if recorder is not None:
            recorded = f"{recorder.recorded} sets in {recorder.path}" if recorder.recorded else "nothing"
            rows.append(["recorded", recorded])
            if recorder.left_out:
                rows.append(["", f"{recorder.left_out} lost, because the disk is too slow"])
            if recorder.went_back:
                rows.append(["", f"{recorder.went_back} lost, because their stamps are before recorded ones"])
            if recorder.fault is not None:
                rows.append(["", f"ended early: {recorder.fault}"])
        known = {f"{name}: {last}" if name else f"stamps {last}" for name, last in self._reasons.items()}
        more = [fault for fault in faults if fault not in known]
        return listing([*rows, *(["fault", fault] for fault in more[-5:])])


FIRST_LOOK = 0.5  # time before the first check of running cameras [s]


class Lookout:
    """Checks running cameras for swaps until an object is found with certainty.

    A check has its own tracker and takes as long as several detections; the pause doubles after each.
    """

    def __init__(self, make_tracker: Callable[[], tracker.ObjectTracker]) -> None:
        self._make, self._pause = make_tracker, FIRST_LOOK
        self._due = time.monotonic() + self._pause
        self._before: set[str] = set()

    def look(self, moment: Moment | None) -> str | None:
        """Check the newest moment if a check is due; return the warning once, else None."""
        if moment is None:
            return None
        pose, agreed = moment.object_pose, tracker.CameraUse.CONTRADICTING not in moment.cameras
        if pose is not None and pose.confidence >= SURE and agreed:
            self._due = math.inf
        if time.monotonic() < self._due:
            return None
        warning = swapped(self._make(), moment.taken.images)
        self._pause *= 2
        self._due = time.monotonic() + self._pause
        if warning is None:
            return None
        if warning not in self._before:  # confirm it once: even if the scene is the same, the noise differs
            self._before.add(warning)
            return None
        self._due = math.inf
        return warning


def check_cameras(source: ImageSource, rig: tracker.CameraRig, seconds: float | None) -> None:
    """Print a table of the cameras and their faults; exit with 1 if there are any, 2 without any image."""
    looks = look_at(source, rig, seconds or 10.0)
    rows = [["camera", "images", "missing", "late [ms]", "grey level", "clipped [%]", "blur [px]"]]
    for one in looks.cameras:
        level, clipped, blur = one.look
        numbers = [f"{1e3 * one.skew:.1f}", f"{level:.0f}", f"{clipped:.1f}", f"{blur:.2f}"]
        rows.append([one.name, str(one.pictures), str(sum(one.missing.values())), *numbers])
    faults = looks.faults()
    pace = f", {looks.rate:.1f} Hz" if looks.seconds else ""
    click.echo(f"{looks.sets} sets in {looks.seconds:.1f} s{pace}\n{table(rows)}\n")
    click.echo("\n".join(faults) if faults else "nothing is wrong with the cameras")
    if faults:
        raise click.exceptions.Exit(1 if any(one.pictures for one in looks.cameras) else 2)
