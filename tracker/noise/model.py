"""Models of the tracker's errors as data: one TOML file each, see docs/noise.md."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from tracker.checks import is_number, is_whole, path_of
from tracker.errors import TrackerError, shown
from tracker.files import read_bounded
from tracker.files.toml import parse_toml
from tracker.noise.state import NoiseState

_ERROR = ("bias", "bias_spread", "slow", "fast", "fast_spread", "seconds", "travel", "visible")

UNITS: Mapping[str, Mapping[str, str]] = {
    "position": dict(zip(_ERROR, ("m", "1", "m", "m", "1", "s", "m", "1"), strict=True)),
    "rotation": dict(zip(_ERROR, ("rad", "1", "rad", "rad", "1", "s", "m", "1"), strict=True)),
    "gross": {"rate": "1/s", "visible": "1", "seconds": "s", "distance": "m", "angle": "rad", "spread": "1"},
    "missed": {"lost": "1/s", "lost_visible": "1", "found": "1/s", "found_visible": "1"},
    "confidence": {"clear": "1", "visible": "1", "distance": "1/m", "angle": "1/rad", "spread": "1"},
    "delay": {"images": "s", "pose": "s", "spread": "1"},
}
"""The numbers of a model, by group, and the unit of each."""

LARGEST = 5000
"""Largest file of a model [bytes]."""

_DATA = resources.files("tracker.noise") / "data"


@dataclass(frozen=True)
class Number:
    """A number of a model and how well it is known."""

    value: float
    """Zero or more."""
    unit: str
    """As of UNITS."""
    interval: tuple[float, float] | None
    """Of 95 %; None: the number was not measured here."""


NumbersOf = Mapping[str, Mapping[str, Number]]
"""Numbers by group and name."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """How the poses of a tracker differ from true ones."""

    name: str
    """Of the preset, or the path of its file."""
    about: str
    """What was measured, and how."""
    numbers: NumbersOf
    """Groups and names as of UNITS."""

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> NoiseModel:
        """A preset by name, or a model of your own by the path of its TOML file.

        `platform` is this tracker with the platform's calibrations, `platform_refined` the same with cameras
        that agree, `predecessor` the platform's tracker before it.

        Raises:
            TrackerError: the name is unknown (the message lists those that are), or the file is missing or
                malformed.
        """
        path = path_of(name_or_path, "noise model", TrackerError)
        text = str(path)
        if text in preset_names():
            return _parsed((_DATA / f"{text}.toml").read_bytes(), text)
        if path.suffix != ".toml":
            valid = ", ".join(preset_names())
            raise TrackerError(
                f"noise model: found {shown(text)}, expected one of {valid}, or the path of a .toml file"
            )
        try:
            content = read_bounded(path, LARGEST)
        except OSError as error:
            raise TrackerError(f"noise model {text}: {error.strerror or error}") from error
        return _parsed(content, text)

    def start(self, rng: np.random.Generator, count: int) -> NoiseState:
        """The errors of so many environments, each at the beginning of an episode.

        Args:
            rng: source of all randomness; the same generator and arguments give the same bits.
            count: number of environments, 1 or more.

        Raises:
            TrackerError: an argument is of another kind.
        """
        if not isinstance(rng, np.random.Generator):
            raise TrackerError(f"rng: found {shown(rng)}, expected a numpy.random.Generator")
        if not is_whole(count) or count < 1:
            raise TrackerError(f"count: found {shown(count)}, expected a whole number of at least 1")
        values = {
            group: {name: number.value for name, number in numbers.items()}
            for group, numbers in self.numbers.items()
        }
        return NoiseState(values, rng, int(count))


def preset_names() -> Sequence[str]:
    """Names of the models that come with the package."""
    return sorted(entry.name[:-5] for entry in _DATA.iterdir() if entry.name.endswith(".toml"))


def _parsed(content: bytes, source: str) -> NoiseModel:
    data = parse_toml(content, f"noise model {source}", TrackerError)
    about = data.pop("about", "")
    _same_keys(data, UNITS, source)
    groups = {}
    for group, units in UNITS.items():
        _same_keys(data[group], units, f"{source}: {group}")
        groups[group] = {
            name: _number(data[group][name], unit, f"noise model {source}: {group}.{name}")
            for name, unit in units.items()
        }
    return NoiseModel(source, str(about), groups)


def _same_keys(found: Any, expected: Mapping[str, Any], source: str) -> None:
    keys = set(found) if isinstance(found, dict) else set()
    for key in sorted(keys ^ set(expected)):
        what = "is missing" if key in expected else "is unknown"
        raise TrackerError(f"noise model {source}: {key!r} {what}; expected are {', '.join(expected)}")


def _number(entry: Any, unit: str, what: str) -> Number:
    valid = f"{{value, unit = '{unit}', interval}}"
    if not isinstance(entry, dict) or set(entry) != {"value", "unit", "interval"} or entry["unit"] != unit:
        raise TrackerError(f"{what}: found {shown(entry)}, expected {valid}")
    value, interval = entry["value"], entry["interval"]
    if not is_number(value) or not 0.0 <= value < 1e6:
        raise TrackerError(f"{what}: found value {shown(value)}, expected 0 or more")
    if interval == []:
        return Number(float(value), unit, None)
    if not isinstance(interval, list) or len(interval) != 2 or not all(map(is_number, interval)):
        raise TrackerError(f"{what}: found interval {shown(interval)}, expected two numbers, or none")
    if not interval[0] <= value <= interval[1]:
        raise TrackerError(f"{what}: found {value} outside its interval {interval}, expected it inside")
    return Number(float(value), unit, (float(interval[0]), float(interval[1])))
