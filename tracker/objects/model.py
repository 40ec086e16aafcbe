"""Object models: cuboids whose six faces have six different colours.

A TOML file describes an object:

    name = "cube_v2"
    size = [0.065, 0.065, 0.065]  # edge lengths along the object's x, y, z [m]
    colors = "cube_v2"            # colour model; default: the object's name
    rim = 0.0002                  # how far within the nominal edges the colours end [m]; default: 0
    rim_std = 0.0002              # standard deviation of rim [m]; default: 0.0003

    [faces]                       # outward axis = colour
    "+x" = "red"
    "-x" = "magenta"
    "+y" = "green"
    "-y" = "yellow"
    "+z" = "blue"
    "-z" = "cyan"
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracker.checks import Frozen, freeze, is_number, naming
from tracker.conventions import Array, FloatArray
from tracker.errors import ObjectModelError, shown
from tracker.files import found_by, names_in
from tracker.files.toml import read_toml
from tracker.geometry.cuboid import FACE_NAMES
from tracker.objects.labels import COLOR_NAMES

MIN_SIZE, MAX_SIZE = 0.005, 0.5
"""Shortest and longest edge of a model [m]."""

_KEYS = ("name", "size", "faces", "colors", "rim", "rim_std")

RIM_STD = 0.0003
"""Standard deviation of an unknown rim, wide enough for real objects [m]."""

LEAST_RIM_STD = 1e-6
"""Smallest standard deviation of a rim, for one that is exact [m]."""

_FACE_COLORS = COLOR_NAMES[1:]
_DATA = Path(__file__).parent / "data"


@dataclasses.dataclass(frozen=True, eq=False)
class CuboidModel(Frozen):
    """A cuboid with six differently coloured faces. Arrays are copied and read-only.

    Attributes:
        name: name of the object.
        size: (3,) edge lengths along the object's x, y, z [m].
        face_labels: (6,) colours of the faces +x, -x, +y, -y, +z, -z: 1 red, 2 green, 3 blue, 4 cyan,
            5 magenta, 6 yellow.
        colors: name or file of the object's colour model.
        rim: how far inside the nominal edges the face colours end, because edges are rounded and worn [m].
        rim_std: standard deviation of the rim [m].

    Raises:
        ObjectModelError: a value is malformed or impossible.
    """

    name: str
    size: FloatArray
    face_labels: Array
    colors: str
    rim: float = 0.0
    rim_std: float = RIM_STD

    def __post_init__(self) -> None:
        for key in ("name", "colors"):
            value = getattr(self, key)
            if not isinstance(value, str) or not value:
                raise ObjectModelError(f"object {key}: found {shown(value)}, expected a non-empty string")
        size = _numbers(self.name, "size", self.size, 3)
        if not ((size >= MIN_SIZE) & (size <= MAX_SIZE)).all():
            valid = f"edges from {MIN_SIZE} to {MAX_SIZE} m"
            raise ObjectModelError(f"{self.name}: size: found {size.tolist()}, expected {valid}")
        labels = _numbers(self.name, "face_labels", self.face_labels, 6)
        if sorted(labels.tolist()) != list(range(1, len(COLOR_NAMES))):
            found = labels.tolist()
            raise ObjectModelError(f"{self.name}: face_labels: found {found}, expected each of 1 to 6 once")
        for key, least in (("rim", 0.0), ("rim_std", LEAST_RIM_STD)):
            value, largest = _numbers(self.name, key, [getattr(self, key)], 1).item(), size.min() / 4
            if not least <= value <= largest:
                valid = f"from {least:g} to {largest:g} m, a quarter of the shortest edge"
                raise ObjectModelError(f"{self.name}: {key}: found {value:g}, expected a width {valid}")
            object.__setattr__(self, key, value)
        freeze(self, "size", size)
        freeze(self, "face_labels", labels.astype(np.int64))

    def __repr__(self) -> str:
        size = "×".join(f"{1e3 * edge:g}" for edge in self.size)
        faces = ", ".join(
            f"{face} {COLOR_NAMES[label]}" for face, label in zip(FACE_NAMES, self.face_labels, strict=True)
        )
        return f"CuboidModel({self.name!r}: {size} mm, {faces}; colours {self.colors!r})"


class Box(NamedTuple):
    """A cuboid with labelled faces, in a form for compiled functions."""

    half: FloatArray
    """(3,) half edge lengths [m]."""
    face_labels: Array
    """(6,) uint8 labels in the order of tracker.geometry.cuboid.FACE_NAMES."""
    rim: tuple[float, float]
    """How far inside the nominal edges the face colours end, and the standard deviation of that [m]."""

    @classmethod
    def of(cls, model: CuboidModel) -> Box:
        """Return the box of an object model."""
        labels = np.asarray(model.face_labels, dtype=np.uint8)
        return cls(np.asarray(model.size) / 2, labels, (model.rim, model.rim_std))

    @property
    def radius(self) -> float:
        """Distance of the corners from the centre [m]."""
        return math.sqrt(self.half @ self.half)

    def lowest(self, position: FloatArray, rotation: FloatArray) -> float:
        """Return z of the lowest corner [m] at a position (3,) [m] and rotation (3, 3), world from object."""
        depths = (abs(one) * half for one, half in zip(rotation[2].tolist(), self.half.tolist(), strict=True))
        return float(position[2] - sum(depths))


def object_names() -> tuple[str, ...]:
    """Return the names of the objects in the package."""
    return names_in(_DATA, ".toml")


def load_object(name_or_path: str | os.PathLike[str]) -> CuboidModel:
    """Load the model of one of the platform's objects by name, or of your own by the path of its TOML file.

    The module's docstring shows the format. A file in `colors` is relative to the TOML file.

    Raises:
        ObjectModelError: the name is unknown (the message lists the known ones), or the file is
            missing, malformed, or gives a different object the name of one of the platform's.
    """
    path = found_by(name_or_path, _DATA, ".toml", "object", ObjectModelError)
    data = read_toml(path, ObjectModelError, _KEYS, "object")
    for key in ("name", "size", "faces"):
        if key not in data:
            raise ObjectModelError(f"{path}: key {key!r} is missing; expected are {', '.join(_KEYS)}")
    colors = data.get("colors", data["name"])
    if isinstance(colors, str) and (colors.endswith(".npz") or os.path.isfile(path.parent / colors)):
        colors = str(path.parent / colors)
    rim = {key: data[key] for key in ("rim", "rim_std") if key in data}
    with naming(path, ObjectModelError):
        model = CuboidModel(data["name"], data["size"], face_labels_of(data["faces"]), colors, **rim)
    if path.parent != _DATA and model.name in object_names():
        other = load_object(model.name)  # files of poses hold the name alone
        if (model.size != other.size).any() or (model.face_labels != other.face_labels).any():
            found = f"found {model.name}, an object of another size or other faces in the package"
            raise ObjectModelError(f"{path}: name: {found}, expected a new name")
    return model


def to_toml(model: CuboidModel) -> str:
    """Return an object as the text of a TOML file that `load_object` reads.

    ObjectModelError if its name or colours, such as a path, are not Unicode, which TOML cannot hold.
    """
    faces = [
        f'"{face}" = "{COLOR_NAMES[label]}"'
        for face, label in zip(FACE_NAMES, model.face_labels.tolist(), strict=True)
    ]
    # Strings and lists of numbers are the same in JSON and TOML, except emojis and the character DEL.
    values = {
        "name": model.name, "size": model.size.tolist(), "colors": model.colors, "rim": model.rim,
        "rim_std": model.rim_std,
    }  # fmt: skip
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in values.items()]
    text = "\n".join([*lines, "", "[faces]", *faces, ""]).replace("\x7f", "\\u007f")
    with naming(f"object {shown(model.name)}: cannot be written", ObjectModelError, UnicodeEncodeError):
        text.encode()
    return text


def face_labels_of(faces: Any) -> Array:
    """Return labels (6,), in the order of FACE_NAMES, of a table {face: colour}; else ObjectModelError."""
    if not isinstance(faces, dict) or set(faces) != set(FACE_NAMES):
        found = sorted(faces) if isinstance(faces, dict) else type(faces).__name__
        raise ObjectModelError(f"faces: found {found}, expected a table of {', '.join(FACE_NAMES)}")
    for face, color in faces.items():
        if color not in _FACE_COLORS:
            valid = ", ".join(_FACE_COLORS)
            raise ObjectModelError(f"faces: {face}: found {shown(color)}, expected one of {valid}")
    used = list(faces.values())
    twice = sorted({color for color in used if used.count(color) > 1})
    if twice:
        raise ObjectModelError(f"faces: found {twice[0]} twice, expected each colour once")
    return np.array([COLOR_NAMES.index(faces[face]) for face in FACE_NAMES], dtype=np.int64)


def _numbers(name: str, key: str, value: Any, count: int) -> FloatArray:
    """Return `value` as (count,) finite numbers; ObjectModelError if it is anything else."""
    sequence = value.tolist() if isinstance(value, np.ndarray) else value
    valid = f"{count} finite numbers"
    if not isinstance(sequence, (list, tuple)) or len(sequence) != count:
        raise ObjectModelError(f"{name}: {key}: found {shown(sequence)}, expected {valid}")
    for item in sequence:
        if not is_number(item) or not abs(item) < 1e9:
            raise ObjectModelError(f"{name}: {key}: found {shown(item)}, expected {valid}")
    return np.array(sequence, dtype=np.float64)
