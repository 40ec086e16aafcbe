"""Noise models of the tracker's errors, one TOML file each, and noisy poses; see docs/noise.md."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tracker.checks import array_of, float_array, is_number, is_whole
from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError, shown
from tracker.files import found_by
from tracker.files.toml import read_toml

_ERROR = ("bias", "bias_spread", "slow", "fast", "fast_spread", "moving", "travel", "visible")

UNITS: Mapping[str, Mapping[str, str]] = {
    "position": dict(zip(_ERROR, ("m", "1", "m", "m", "1", "s/m", "m", "1"), strict=True)),
    "rotation": dict(zip(_ERROR, ("rad", "1", "rad", "rad", "1", "s/m", "m", "1"), strict=True)),
    "gross": {"rate": "1/s", "visible": "1", "seconds": "s", "distance": "m", "angle": "rad", "spread": "1"},
    "missed": {"lost": "1/s", "lost_visible": "1", "found": "1/s", "found_visible": "1"},
    "confidence": {"clear": "1", "visible": "1", "distance": "1/m", "angle": "1/rad", "spread": "1"},
    "delay": {"images": "s", "pose": "s", "spread": "1"},
}
"""The numbers of a model by group, and the unit of each."""

MOST_ENVIRONMENTS = 10**7
"""Largest number of environments, which need 0.6 kB each."""

RADIUS = 0.05
"""Distance that counts as much as a rotation by one radian [m]."""

LEAST_VISIBLE = 0.05
"""Lower bound of the visible share, except in the rates of missed poses and gross errors."""

FASTEST = 1.0
"""Speed beyond which errors grow no further [m/s]: the films contain no faster motion."""

ROUNDED = 1e-6
"""Visible shares out of range by no more than this are rounding errors."""

_MOST = 60.0
"""Largest exponent of a rate."""

_LARGEST = {"clear": 1.0, "visible": 30.0, "spread": 10.0}
"""Largest numbers by the last word of their names, others 1e6; more is no probability, or no finite pose."""

_DATA = Path(__file__).parent / "data"


@dataclass(frozen=True)
class Number:
    """A number of a model, and how well it is known."""

    value: float
    """Zero or more."""
    unit: str
    """Unit as in UNITS."""
    interval: tuple[float, float] | None
    """95 % interval; None: the number was not measured here."""


NumbersOf = Mapping[str, Mapping[str, Number]]
"""Numbers by group and name."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """A statistical model of a tracker's pose errors."""

    name: str
    """Name of the preset, or path of the file."""
    about: str
    """What was measured, and how."""
    numbers: NumbersOf
    """Numbers with groups and names as in UNITS."""

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> NoiseModel:
        """Load a preset by name, or your own model by the path of its TOML file.

        `platform` is this tracker with the platform's calibrations, `platform_refined` the same with refined
        calibrations, `predecessor` the platform's own tracker.

        Raises:
            TrackerError: the name is unknown (the message lists the known ones), or the file is missing or
                malformed.
        """
        path = found_by(name_or_path, _DATA, ".toml", "noise model", TrackerError)
        data, source = read_toml(path, TrackerError, what="noise model"), os.fspath(name_or_path)
        about = data.pop("about", "")
        _same_keys(data, UNITS, source)
        groups = {}
        for group, units in UNITS.items():
            _same_keys(data[group], units, f"{source}: {group}")
            groups[group] = {
                name: _number(data[group][name], unit, f"noise model {source}: {group}.{name}")
                for name, unit in units.items()
            }
        return cls(source, str(about), groups)

    def start(self, rng: np.random.Generator, count: int) -> NoiseState:
        """Return the errors of `count` environments, each at the beginning of an episode.

        Args:
            rng: source of all randomness; the same generator and arguments give the same bits.
            count: number of environments, 1 or more.

        Raises:
            TrackerError: an argument has the wrong type or value.
        """
        if not isinstance(rng, np.random.Generator):
            raise TrackerError(f"rng: found {shown(rng)}, expected a numpy.random.Generator")
        if not is_whole(count) or not 1 <= count <= MOST_ENVIRONMENTS:
            valid = f"a whole number from 1 to {MOST_ENVIRONMENTS:,}"
            raise TrackerError(f"count: found {shown(count)}, expected {valid}")
        values = {
            group: {name: number.value for name, number in numbers.items()}
            for group, numbers in self.numbers.items()
        }
        return NoiseState(values, rng, int(count))


def _same_keys(found: Any, expected: Mapping[str, Any], source: str) -> None:
    keys = set(found) if isinstance(found, dict) else set()
    for key in sorted(keys ^ set(expected)):
        what = "is missing" if key in expected else "is unknown"
        raise TrackerError(f"noise model {source}: {key!r} {what}; expected are {', '.join(expected)}")


def largest(name: str) -> float:
    """Return the largest value that a model's number of this name may have."""
    return _LARGEST.get(name.replace("_", ".").rpartition(".")[2], 1e6)


def _number(entry: Any, unit: str, what: str) -> Number:
    valid = f"{{value, unit = '{unit}', interval}}"
    if not isinstance(entry, dict) or set(entry) != {"value", "unit", "interval"} or entry["unit"] != unit:
        raise TrackerError(f"{what}: found {shown(entry)}, expected {valid}")
    value, interval = entry["value"], entry["interval"]
    most = largest(what)
    if not is_number(value) or not 0.0 <= value <= most:
        raise TrackerError(f"{what}: found value {shown(value)}, expected 0 to {most:g}")
    if interval == []:
        return Number(float(value), unit, None)
    pair = isinstance(interval, list) and len(interval) == 2 and all(map(is_number, interval))
    if not pair or not interval[0] <= value <= interval[1]:
        valid = f"two numbers around {value}, or none"
        raise TrackerError(f"{what}: found interval {shown(interval)}, expected {valid}")
    return Number(float(value), unit, (float(interval[0]), float(interval[1])))


@dataclass(frozen=True, eq=False)
class Seen:
    """The noisy poses of N environments in one step."""

    position: FloatArray
    """(N, 3) [m] in the world; nan where nothing was found."""
    orientation: FloatArray
    """(N, 4) xyzw, world from object, w ≥ 0 as the tracker's; nan where nothing was found."""
    found: Array
    """(N,) bool: whether the object was found; an old pose is never repeated."""
    confidence: FloatArray
    """(N,) probability that the pose is within 5 mm and 5°; 0 where nothing was found."""
    delay: FloatArray
    """(N,) time from the exposure, when the object has the true pose, to the answer [s]."""


class NoiseState:
    """The errors of N environments, made by `NoiseModel.start`. Plain NumPy, vectorised over environments.

    Errors (δp, δθ) are along world axes: p̂ = p + δp and R̂ = exp(δθ) R. They are the sum of

        bias    drawn once per episode: the error of its calibration,
        slow    decays with the object's path length: exp(-path / travel),
        fast    drawn at each step, with heavy tails; grows with the object's speed: 1 + moving · speed,

    where slow and fast are multiplied by (visible share)^-visible, and of an occasional gross error.

    Args:
        values: numbers by group and name, as in `tracker.noise.model.UNITS`.
        rng: source of all randomness.
        count: N.
    """

    def __init__(self, values: Mapping[str, Mapping[str, float]], rng: np.random.Generator, count: int):
        self._values, self._rng, self.count = values, rng, count
        pair = values["position"], values["rotation"]
        # First axis: position and rotation; then x, y, z; then environments.
        self._of = {key: np.array([[[one[key]]] for one in pair]) for key in pair[0]}
        self._bias, self._slow, self._gross = np.zeros((3, 2, 3, count))
        self._scale, self._doubt = np.zeros((2, 1, count)), np.zeros(count)
        self._is_gross = np.zeros(count, bool)
        self._found, self._fresh = np.zeros(count, bool), np.zeros(count, bool)
        self._last = np.zeros((count, 3)), np.zeros((count, 4))
        self.reset()

    def reset(self, which: Any = None) -> None:
        """Begin new episodes, with new calibrations and no memory of earlier steps.

        Args:
            which: the environments, (N,) bool or their indices; None: all.

        Raises:
            TrackerError: `which` is neither, or an index is out of range or repeated.
        """
        rows = np.arange(self.count) if which is None else self._rows(which)
        size = len(rows)
        scale = np.exp(self._of["bias_spread"] * self._rng.standard_normal((2, 1, size)))
        self._scale[..., rows] = scale
        self._bias[..., rows] = scale * self._of["bias"] * self._rng.standard_normal((2, 3, size))
        self._slow[..., rows] = self._rng.standard_normal((2, 3, size))
        self._doubt[rows] = self._rng.standard_normal(size)
        self._is_gross[rows] = False
        self._fresh[rows] = True

    def step(self, position: Any, orientation: Any, visible: Any, dt: float) -> Seen:
        """Return the noisy poses for the next images.

        Args:
            position: (N, 3) true position of the object in the world [m].
            orientation: (N, 4) true orientation, xyzw; need not be of unit length.
            visible: (N,) visible share of the object's pixels, averaged over the cameras, 0 to 1.
            dt: time since the previous images [s], more than 0; 0.1 on the platform.

        Raises:
            TrackerError: an array has the wrong shape, or values that are not finite or are out of range.
        """
        p, q, v = self._checked(position, orientation, visible)
        if not is_number(dt) or dt <= 0:
            raise TrackerError(f"dt: found {shown(dt)}, expected a time of more than 0 s")
        # The way from the previous poses [m]; at rest, rounding leaves up to 1e-15 of the chord.
        shift = p - self._last[0]
        chord = np.maximum(1.0 - 1e-15 - np.abs(np.einsum("ij,ij->i", q, self._last[1])), 0.0)
        way = np.sqrt(np.einsum("ij,ij->i", shift, shift)) + RADIUS * np.sqrt(8.0 * chord)
        way[self._fresh] = 0.0
        keep = np.exp(-way / np.maximum(self._of["travel"][:, 0], 1e-12))
        clear = np.maximum(v, LEAST_VISIBLE)
        error = self._errors(keep, np.minimum(way / dt, FASTEST), clear, self._gross_now(v, float(dt)))
        found = self._found_now(v, float(dt))
        confidence = self._confidence(error, keep[0], clear)
        delay = self._values["delay"]
        late = delay["images"] + delay["pose"] * np.exp(
            delay["spread"] * self._rng.standard_normal(self.count)
        )
        seen, turned = p + error[0].T, _turned(error[1], q)
        missed = np.flatnonzero(~found)
        seen[missed] = turned[missed] = np.nan
        self._last, self._fresh[:] = (p, q), False
        return Seen(seen, turned, found, np.where(found, confidence, 0.0), late)

    def _rows(self, which: Any) -> Array:
        chosen = array_of(which)
        if chosen.dtype == bool and chosen.shape == (self.count,):
            return np.flatnonzero(chosen)
        numbers = chosen.size == 0 or chosen.dtype.kind in "iu"
        rows = np.unique(chosen) if numbers else chosen
        if not numbers or rows.size < chosen.size or not ((rows >= 0) & (rows < self.count)).all():
            valid = f"({self.count},) bool, or different numbers from 0 to {self.count - 1}"
            raise TrackerError(f"which: found {shown(which)}, expected {valid}")
        return rows.astype(np.int64)

    def _checked(self, position: Any, orientation: Any, visible: Any) -> tuple[FloatArray, ...]:
        p = float_array(position, (self.count, 3), "position", TrackerError)
        q = float_array(orientation, (self.count, 4), "orientation", TrackerError)
        v = float_array(visible, (self.count,), "visible", TrackerError)
        length = np.sqrt(np.einsum("ij,ij->i", q, q))
        if not (length.min() > 1e-6 and length.max() < 1e100):
            found = f"{length.max():g}" if length.min() > 1e-6 else "0"
            raise TrackerError(f"orientation: found one of length {found}, expected quaternions (x, y, z, w)")
        if v.min() < -ROUNDED or v.max() > 1.0 + ROUNDED:
            raise TrackerError(f"visible: found {v.min():.7g} to {v.max():.7g}, expected shares from 0 to 1")
        return p, q / length[:, None], v.clip(0.0, 1.0)

    def _errors(
        self, keep: FloatArray, speed: FloatArray, clear: FloatArray, gross: FloatArray
    ) -> FloatArray:
        """Draw the errors (2, 3, N) [m, rad]."""
        # Drawing in single precision takes half the time.
        drawn = self._rng.standard_normal((14, self.count), dtype=np.float32)
        kept, spread = keep[:, None], drawn[12:, None]
        slow, fast = drawn[:12].reshape(2, 2, 3, -1)
        self._slow *= kept
        self._slow += np.sqrt(1.0 - kept * kept) * slow
        hidden = self._of["visible"] * np.log(clear)
        result: FloatArray = self._bias + gross
        result += self._of["slow"] * self._scale * np.exp(-hidden) * self._slow
        scatter = self._of["fast"] * (1.0 + self._of["moving"] * speed)
        result += scatter * np.exp(self._of["fast_spread"] * spread - hidden) * fast
        return result

    def _gross_now(self, v: FloatArray, dt: float) -> FloatArray:
        """Return the gross errors (2, 3, N) [m, rad], each constant until it ends; 0 if there is none."""
        own, drawn = self._values["gross"], self._rng.random(self.count)
        rate, ends = own["rate"] * np.exp(-own["visible"] * v), 1.0 / max(own["seconds"], 1e-12)
        now = drawn < self._after(self._is_gross, rate, ends, dt)
        new = np.flatnonzero(now & ~(self._is_gross & (drawn < np.exp(-dt * ends))))
        self._is_gross = now
        drawn = self._rng.standard_normal((2, 3, len(new)))
        drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
        size = np.exp(own["spread"] * self._rng.standard_normal((2, len(new))))
        size *= np.array([[own["distance"]], [own["angle"]]])
        self._gross[..., new] = drawn * size[:, None]
        self._gross[..., ~now] = 0.0
        return self._gross

    def _found_now(self, v: FloatArray, dt: float) -> Array:
        """Draw (N,) whether the object is found; never if nothing of it is visible."""
        own, drawn = self._values["missed"], self._rng.random(self.count)
        lost = own["lost"] * np.exp(np.maximum(-own["lost_visible"] * v, -_MOST))
        found = max(own["found"], 1e-300) * np.exp(np.minimum(own["found_visible"] * v, _MOST))
        self._found = (v > 0.0) & (drawn < self._after(self._found, found, lost, dt))
        return self._found.copy()

    def _after(self, on: Array, begins: FloatArray, ends: FloatArray | float, dt: float) -> FloatArray:
        """Return the probabilities (N,) that two-state Markov chains are on after dt.

        on: (N,) whether they are before; begins, ends: rates [1/s].
        """
        # The equilibrium probability, and the share of the deviation from it that remains.
        rest = begins / np.maximum(begins + ends, 1e-300)
        stays = np.where(self._fresh, 0.0, np.exp(-dt * (begins + ends)))
        return np.asarray(rest + (on - rest) * stays)

    def _confidence(self, error: FloatArray, keep: FloatArray, clear: FloatArray) -> FloatArray:
        own = self._values["confidence"]
        if not 0.0 < own["clear"] < 1.0:
            return np.full(self.count, own["clear"])
        self._doubt = keep * self._doubt + np.sqrt(1.0 - keep * keep) * self._rng.standard_normal(self.count)
        size = np.sqrt(np.einsum("kij,kij->kj", error, error))
        logit = np.log(own["clear"] / (1.0 - own["clear"])) + own["visible"] * np.log(clear)
        logit += own["spread"] * self._doubt - own["distance"] * size[0] - own["angle"] * size[1]
        return np.asarray(1.0 / (1.0 + np.exp(np.minimum(-logit, _MOST))))


def _turned(turn: FloatArray, q: FloatArray) -> FloatArray:
    """Turn orientations (N, 4) xyzw by rotation vectors (3, N) [rad] along world axes; give w ≥ 0."""
    half = np.maximum(0.5 * np.sqrt(np.einsum("ij,ij->j", turn, turn)), 1e-300)
    x, y, z = turn * (0.5 * np.sin(half) / half)
    w = np.cos(half)
    a, b, c, d = np.ascontiguousarray(q.T)
    result = np.empty_like(q)
    result[:, 0] = w * a + x * d + y * c - z * b
    result[:, 1] = w * b - x * c + y * d + z * a
    result[:, 2] = w * c + x * b - y * a + z * d
    result[:, 3] = w * d - x * a - y * b - z * c
    return np.where(result[:, 3:] < 0.0, -result, result)
