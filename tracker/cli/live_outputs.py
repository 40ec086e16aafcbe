"""What `tracker live` hands its poses to, beside the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.live import Live, Moment, Source
    from tracker.live.page import Page
    from tracker.live.publishing import Publisher
    from tracker.live.recorder import Recorder
    from tracker.live.rerun_view import RerunView
    from tracker.objects.model import CuboidModel
    from tracker.segmentation.color_model import ColorModel


@dataclass(frozen=True)
class Wanted:
    """What the options ask for, each as the option of its name has it."""

    addresses: Sequence[str]
    """Where to publish."""
    public: bool
    body: str | None
    record: Path | None
    view: bool
    rrd: Path | None
    page: int | None
    as_json: bool


class Outputs:
    """All of it, opened; `listeners` hear of each moment.

    Args:
        wanted: by the options.
        source: whose settings are recorded.
        rig: the cameras.
        model: the object.
        colors: its colours; None: the model's own.
        stack: closes it all.

    Raises:
        TrackerError: something cannot be opened.
    """

    def __init__(
        self,
        wanted: Wanted,
        source: Source,
        rig: CameraRig,
        model: CuboidModel,
        colors: ColorModel | None,
        stack: ExitStack,
    ) -> None:
        self.recorder: Recorder | None = None
        self.listeners: list[Callable[[Moment], None]] = []
        self._page: Page | None = None
        self._fallible: dict[Recorder | Publisher | RerunView, str] = {}
        self._told: set[Recorder | Publisher | RerunView] = set()
        if wanted.record is not None:
            self.recorder = _recorder(wanted.record, rig, source)
            self._add(self.recorder, stack)
            self._fallible[self.recorder] = "the recording has ended: "
        for address in wanted.addresses:
            from tracker.live.publishing import open_publisher

            publisher = open_publisher(address, model, body=wanted.body, public=wanted.public)
            self._add(publisher, stack)
            self._fallible[publisher] = ""
        if wanted.view or wanted.rrd:
            from tracker.live.rerun_view import RerunView

            shown = RerunView(wanted.rrd, rig, model)
            self._add(shown, stack)
            self._fallible[shown] = "the view has ended: "
        if wanted.page is not None:
            from tracker.live.page import Page
            from tracker.pipeline import ObjectTracker

            self._page = Page(wanted.page, ObjectTracker(model, rig, colors))
            self._add(self._page, stack)
            click.echo(f"page: {self._page.address}", err=True)
        if wanted.as_json:
            self.listeners.append(_print)

    def know(self, follower: Live) -> None:
        """Whom they hear."""
        if self._page is not None:
            self._page.faults = lambda: follower.faults

    def faults(self) -> list[str]:
        """What became of those that ended or failed, but for the recorder."""
        failed = self._fallible.items()
        return [f"{what}{one.fault}" for one, what in failed if one.fault and one is not self.recorder]

    def tell(self) -> None:
        """Say on stderr what has ended or failed, of each once, when it happens."""
        for one, what in self._fallible.items():
            if one.fault and one not in self._told:
                self._told.add(one)
                click.echo(f"{what}{one.fault}", err=True)

    def _add(self, output: Recorder | Publisher | RerunView | Page, stack: ExitStack) -> None:
        stack.callback(output.close)
        self.listeners.append(output)


def refuse_what_publishes_nothing(addresses: Sequence[str], public: bool, body: str | None) -> None:
    """Refuse options that would do nothing without an address."""
    from tracker.live.publishing import is_lcm

    if public and not addresses:
        raise click.UsageError("--public: expected with --publish")
    if body is not None and not any(map(is_lcm, addresses)):
        raise click.UsageError("--body: expected with --publish lcm://")


def _recorder(path: Path, rig: CameraRig, source: Source) -> Recorder:
    from tracker.live.recorder import Recorder

    if path.suffix.lower() not in (".h5", ".hdf5"):
        raise click.UsageError(f"--record {path}: found suffix {path.suffix!r}, expected .h5")
    return Recorder(path, rig, lambda: getattr(source, "settings", ()))


def _print(moment: Moment) -> None:
    from tracker.live.message import message_of

    click.echo(message_of(moment).decode())
