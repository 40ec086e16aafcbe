"""Sources by the words with which a command names them."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.errors import LiveError
from tracker.files.toml import read_toml
from tracker.live.moment import ImageSource
from tracker.live.sources.cameras import RATE, CameraSet, LiveCamera
from tracker.live.sources.drivers import OpenCvCamera, PylonCamera, pylon_serials
from tracker.live.sources.without_cameras import Replay, Simulation
from tracker.pipeline import ObjectTracker

CAMERAS, SIMULATION = ("pylon", "opencv"), "simulation"
FORMS = "a recording's path, pylon, pylon:SERIAL,…, opencv:0,1,2 or simulation"


def open_source(source: str | os.PathLike[str], tracker: ObjectTracker) -> ImageSource:
    """The source that a text names, for the tracker's cameras: see FORMS.

    Raises:
        TrackerError: it cannot be opened.
    """
    text = os.fspath(source)
    kind = text.partition(":")[0]
    if kind in CAMERAS:
        return open_cameras(text, tracker.rig)
    if text == SIMULATION:
        simulation = Simulation(tracker.model.name)
        own, its = (
            [[*camera.matrix.ravel(), *camera.camera_from_world.ravel()] for camera in rig]
            for rig in (simulation.rig, tracker.rig)
        )
        if len(own) != len(its) or not np.allclose(own, its):
            simulation.close()
            raise LiveError(
                "simulation: found a tracker of other cameras; expected a tracker.live.Simulation in "
                "place of the word, and a tracker of its rig"
            )
        return simulation
    return Replay(text)


def open_cameras(
    source: str, rig: CameraRig, *, rate: float = RATE, settings: Path | None = None
) -> CameraSet:
    """The cameras that a text names, one for each of a rig's, in its order.

    Args:
        source: `pylon`, whose cameras call themselves as the rig's; `pylon:SERIAL,…`; or `opencv:…` with
            numbers, films or addresses.
        rig: says how large the images are.
        rate: sets of pictures per second [Hz].
        settings: a TOML file of what `pylon`'s cameras are set to: features by their GenICam names, those of
            a table `["SERIAL"]` for one camera only.

    Raises:
        LiveError: the text names none or too few, a setting cannot be read, or a camera is not there.
    """
    kind, _, listed = source.partition(":")
    which = [part.strip() for part in listed.split(",") if part.strip()]
    sizes = [(camera.width, camera.height) for camera in rig]
    openers: list[Callable[[], LiveCamera]]
    if kind == "pylon":
        which = which or pylon_serials(rig.names)
        chosen = settings_of(settings, which)
        openers = [functools.partial(PylonCamera, serial, chosen[serial]) for serial in which]
    elif kind == "opencv" and settings is None:
        openers = [
            functools.partial(OpenCvCamera, one, size) for one, size in zip(which, sizes, strict=False)
        ]
    else:
        found = f"settings for {kind}" if kind == "opencv" else repr(source)
        raise LiveError(f"source: found {found}, expected {FORMS}")
    if len(which) != len(rig):
        raise LiveError(
            f"source {source}: found {len(which)} cameras, expected one for each of {', '.join(rig.names)}"
        )
    return CameraSet(openers, sizes, rate=rate)


def settings_of(path: Path | None, serials: list[str]) -> dict[str, Mapping[str, Any]]:
    """What each camera is set to, from a TOML file; LiveError where that is malformed."""
    values = {} if path is None else read_toml(path, LiveError, what="settings")
    tables = {name: values.pop(name) for name in sorted(values) if isinstance(values[name], dict)}
    for serial in tables:
        if serial not in serials:
            raise LiveError(f"settings {path}: found [{serial}], expected one of {', '.join(serials)}")
    chosen: dict[str, Mapping[str, Any]]
    chosen = {serial: {**values, **tables.get(serial, {})} for serial in serials}
    for name, value in (item for one in chosen.values() for item in one.items()):
        if not isinstance(value, (str, int, float, bool)):
            raise LiveError(
                f"settings {path}: {name}: found {value!r}, expected a text, number, true or false"
            )
    return chosen
