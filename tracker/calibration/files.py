"""The platform's calibration files: one YAML file for each camera.

Keys: camera_name, image_width, image_height and the matrices {rows, cols, data} camera_matrix,
distortion_coefficients, tf_world_to_camera and tf_world_to_camera_std. Variants that are read too:
files of early 2020 have the key projection_matrix instead of tf_world_to_camera; the deviations may be
missing; matrices may have `dt: d` and the tag `!!opencv-matrix`; the header is optional, in YAML's form
or in OpenCV's (`%YAML:1.0`); distortions have 4, 5, 8, 12 or 14 coefficients in OpenCV's order. Files of
ROS (camera_info) describe only a lens, unless tf_world_to_camera is added to them.

Calibrations from photos of a board have two more keys, `camera_matrix_std` and `distortion_coefficients_std`,
which other readers ignore. If only the lens has been calibrated, there is no `tf_world_to_camera`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import re
import sys
from collections.abc import Hashable, Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tracker.checks import is_number, naming
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError, TrackerError, message, shown
from tracker.files import read_bounded, reading, visible
from tracker.geometry import so3
from tracker.geometry.camera import COUNTS, ROTATION_TOLERANCE, Camera, check_rotation

MAX_FILE_SIZE = 100_000
"""Largest file that is parsed [bytes]; real files have 2 kB, and PyYAML takes seconds for a megabyte."""

MAX_ROTATION_DEVIATION = 1e-2
"""Largest |R Rᵀ - I| that is corrected; real files, with element-wise means of rotations, have below 1e-4."""

_MATRIX_KEY, _DISTORTION_KEY = "camera_matrix_std", "distortion_coefficients_std"

TRANSFORM_KEYS = ("tf_world_to_camera", "projection_matrix")
"""Keys of camera_from_world, of current files and of files of early 2020."""


class _Loader(yaml.SafeLoader):
    """YAML loader that accepts only plain values and no duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            # Merge keys can be nested so that they grow exponentially; no calibration needs them.
            merge = key.tag == "tag:yaml.org,2002:merge"
            if merge or (isinstance(key, yaml.ScalarNode) and key.value in seen):
                fault = "merge key '<<'" if merge else f"key {key.value!r} stands twice"
                raise yaml.constructor.ConstructorError(None, None, fault, key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep=deep)


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix", functools.partial(_Loader.construct_mapping, deep=True)
)


class _Dumper(yaml.SafeDumper):
    """YAML dumper that quotes texts which `_Loader` or OpenCV would read as numbers: names like 12e4, 2L."""


# YAML 1.1 reads 1e-05 and 2.5e2 as strings, but writers of YAML 1.2 and C++ print numbers like these. OpenCV
# takes whatever begins like a number for one.
_FLOAT = r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"
for _kind, _number in ((_Loader, _FLOAT), (_Dumper, rf"^[-0-9]|{_FLOAT}")):
    _kind.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(_number), list("-+.0123456789"))


def _read_mapping(path: Path) -> dict[Any, Any]:
    """Return the mapping in a calibration file; CalibrationError if it is not a mapping in plain YAML."""
    with reading(path, CalibrationError):
        content = read_bounded(path, MAX_FILE_SIZE)
    try:
        # OpenCV's header is not valid YAML; the rest of the document is.
        text = re.sub(r"\A%YAML:1\.\d[^\n]*\n", "", content.decode("utf-8-sig"))
        data = yaml.load(text, Loader=_Loader)
    except RecursionError as error:
        raise CalibrationError(f"{path}: nested too deeply, expected a calibration") from error
    # PyYAML lets errors through that Python raises for values such as the date 2001-99-99 or `!!bool 2`.
    except (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise CalibrationError(f"{path}: not plain YAML: {message(error)}") from error
    if not isinstance(data, dict):
        raise CalibrationError(f"{path}: found {shown(data)}, expected a mapping with the key camera_matrix")
    if "distortion_model" in data:
        found, valid = data["distortion_model"], ("plumb_bob", "rational_polynomial")
        if found not in valid:
            expected = " or ".join(valid)
            raise CalibrationError(f"{path}: distortion_model: found {shown(found)}, expected {expected}")
        # In ROS files this key is the 3×4 projection matrix of rectified images.
        data.pop("projection_matrix", None)
    return data


def _transform_of(data: dict[Any, Any]) -> FloatArray:
    transform_key = next((key for key in TRANSFORM_KEYS if key in data), TRANSFORM_KEYS[0])
    if "camera_matrix" in data:
        where = "`tracker calibrate extrinsics` finds its pose; or add that key: [R t; 0 1] of rvec and tvec"
        _require(data, transform_key, f": a lens alone; {where}")
    transform = _matrix_of(data, transform_key, (4, 4))
    transform[:3, :3] = rotation_of(transform[:3, :3], transform_key, CalibrationError)
    if (transform[3] != (0, 0, 0, 1)).any():
        found = transform[3].tolist()
        raise CalibrationError(f"{transform_key}: found the last row {found}, expected [0, 0, 0, 1]")
    return transform


def _camera_of(data: dict[Any, Any], placed: bool) -> Camera:
    transform = _transform_of(data) if placed else np.eye(4)
    std_key = next((f"{key}_std" for key in TRANSFORM_KEYS if data.get(f"{key}_std") is not None), None)
    std = None if std_key is None else _deviations_of(data, std_key, (4, 4))
    shapes = [shape for count in (4, *COUNTS) for shape in ((1, count), (count, 1))]
    distortion = _matrix_of(data, "distortion_coefficients", *shapes).ravel()
    return Camera(
        name=_require(data, "camera_name"),
        width=_require(data, "image_width"),
        height=_require(data, "image_height"),
        matrix=_matrix_of(data, "camera_matrix", (3, 3)),
        distortion=np.append(distortion, 0.0) if len(distortion) == 4 else distortion,  # k3 = 0
        camera_from_world=transform,
        camera_from_world_std=std,
    )


def _require(data: dict[Any, Any], key: str, remark: str = "") -> Any:
    if key not in data:
        found = ", ".join(sorted(map(str, data)))[:200] or "nothing"
        raise CalibrationError(f"key {key} is missing; found {found}{remark}")
    return data[key]


def _matrix_of(data: dict[Any, Any], key: str, *shapes: tuple[int, int]) -> FloatArray:
    """Return the matrix at `key`, which must have one of the shapes."""
    entry = _require(data, key)
    valid = " or ".join(f"{rows}×{cols}" for rows, cols in shapes)
    if not isinstance(entry, dict):
        raise CalibrationError(f"{key}: found {shown(entry)}, expected a mapping of rows, cols and data")
    for part in ("rows", "cols", "data"):
        if part not in entry:
            raise CalibrationError(f"{key}: {part} is missing, expected rows, cols and data")
    rows, cols, values = entry["rows"], entry["cols"], entry["data"]
    if (rows, cols) not in shapes or any(isinstance(size, bool) for size in (rows, cols)):
        raise CalibrationError(f"{key}: found {shown(rows)}×{shown(cols)}, expected {valid}")
    if not isinstance(values, list) or len(values) != rows * cols:
        found = f"{len(values)} values" if isinstance(values, list) else shown(values)
        raise CalibrationError(f"{key}: data: found {found}, expected {int(rows * cols)} numbers")
    for value in values:
        if not is_number(value) or abs(value) >= 1e100:  # whose square overflows
            raise CalibrationError(f"{key}: data: found {shown(value)}, expected a finite number")
    return np.array(values, np.float64).reshape(int(rows), int(cols))


def _deviations_of(data: dict[Any, Any], key: str, shape: tuple[int, int]) -> FloatArray:
    std = _matrix_of(data, key, shape)
    if std.min() < 0:
        raise CalibrationError(f"{key}: found {std.min():g}, expected standard deviations of at least 0")
    return std


def rotation_of(matrix: FloatArray, what: str, fault: type[TrackerError]) -> FloatArray:
    """Return the nearest rotation; `matrix` (3, 3) itself, bitwise, if a Camera accepts it.

    The platform stores element-wise means of rotations. `fault`, naming `what`: it is far from a rotation.
    """
    deviation = check_rotation(matrix, MAX_ROTATION_DEVIATION, what, fault)
    return matrix if deviation <= ROTATION_TOLERANCE else so3.nearest_rotation(matrix)


@dataclasses.dataclass(frozen=True, eq=False)
class Calibrated:
    """A camera and how well its parameters are known."""

    camera: Camera
    matrix_std: FloatArray | None = None
    """Standard deviations (3, 3) of `camera.matrix` [px], or None if unknown."""
    distortion_std: FloatArray | None = None
    """Standard deviations (5,) of `camera.distortion`, or None if unknown."""
    placed: bool = True
    """Whether the camera's pose in the world is known; if not, `camera_from_world` is the identity."""

    def cropped(self, left: int, top: int, width: int, height: int) -> Calibrated:
        """Crop the calibration to `width` × `height` at (left, top) [px]; CalibrationError: outside."""
        one = self.camera
        if not (0 <= left <= one.width - width and 0 <= top <= one.height - height and width > 0 < height):
            raise CalibrationError(
                f"{one.name}: found the part {width}x{height}+{left}+{top}, expected one inside of "
                f"{one.width}x{one.height}"
            )
        return dataclasses.replace(self, camera=one.cropped(left, top, width, height))

    def resized(self, width: int, height: int) -> Calibrated:
        """Return the calibration for images scaled to `width` × `height` [px]; see `Camera.resized`."""
        scale = np.array([[width / self.camera.width], [height / self.camera.height], [1.0]])
        std = None if self.matrix_std is None else self.matrix_std * scale
        return dataclasses.replace(self, camera=self.camera.resized(width, height), matrix_std=std)


def read_calibrated(path: str | os.PathLike[str], *, alone: bool = True) -> Calibrated:
    """Read one of the platform's files with its standard deviations; `alone`: it may describe only a lens.

    CalibrationError names the file and the key that is missing or malformed. See `rotation_of`, too.
    """
    data = _read_mapping(Path(path))
    placed = not alone or any(key in data for key in TRANSFORM_KEYS)
    with naming(os.fspath(path), CalibrationError):
        camera = _camera_of(data, placed)
        matrix = _deviations_of(data, _MATRIX_KEY, (3, 3)) if _MATRIX_KEY in data else None
        bent = _deviations_of(data, _DISTORTION_KEY, (1, 5)).ravel() if _DISTORTION_KEY in data else None
    return Calibrated(camera, matrix, bent, placed)


def file_name(camera: str) -> str:
    """Return the name of a camera's file; `camera` is in it, so that it is read with its folder."""
    return f"{camera}.yml" if "camera" in camera else f"camera_{camera}.yml"


def calibration_text(calibrated: Calibrated) -> str:
    """Return the text of a file for which `read_calibrated` returns bit-identical values."""
    camera, bent = calibrated.camera, calibrated.distortion_std
    matrices = {
        "camera_matrix": camera.matrix,
        "distortion_coefficients": camera.distortion[None],
        "tf_world_to_camera": camera.camera_from_world if calibrated.placed else None,
        "tf_world_to_camera_std": camera.camera_from_world_std,
        _MATRIX_KEY: calibrated.matrix_std,
        _DISTORTION_KEY: None if bent is None else bent[None],
    }
    data: dict[str, Any] = {"camera_name": camera.name, "image_width": camera.width}
    data["image_height"] = camera.height
    for key, matrix in matrices.items():
        if matrix is not None:
            rows, cols = matrix.shape
            data[key] = {"rows": rows, "cols": cols, "dt": "d", "data": matrix.ravel().tolist()}
    # With this header and lists in brackets (default_flow_style=None), OpenCV can read the file, too.
    return "%YAML 1.1\n---\n" + yaml.dump(
        data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100
    )


def calibration_files(root: Path, pattern: str | None) -> list[Path]:
    """Return a folder's files that match `pattern`.

    None: .yml and .yaml files with `camera` in their names, or all if none has it. CalibrationError: there is
    no such file.
    """
    with reading(root, CalibrationError):
        names = sorted(file.name for file in visible(root) if file.is_file())
    if pattern is None:
        readable = [name for name in names if name.endswith((".yml", ".yaml"))]
        files = [name for name in readable if "camera" in name] or readable
        expected = "a file like camera60.yml"
    else:
        files = [name for name in names if fnmatchcase(name, pattern)]
        expected = f"a file that matches {pattern!r}"
    if not files:
        found = ", ".join(names[:12]) or "no files"
        raise CalibrationError(f"{root}: found {found}, expected {expected}")
    return [root / name for name in files]


def _order(camera_name: str, file_name: str) -> tuple[list[int], str, str]:
    """Return a sort key: the numbers in the camera's name, else in the file's name; without one, last."""
    numbers = re.findall(r"\d+", camera_name) or re.findall(r"camera\D*(\d+)", file_name)
    return [int(number) for number in numbers] or [sys.maxsize], camera_name, file_name


def _refuse_variants(folder: Path | None, files: Sequence[str], names: Sequence[str]) -> None:
    """Raise CalibrationError if a camera has several files; for a folder, suggest patterns to select one."""
    twice = min((name for name in names if names.count(name) > 1), default=None)
    if twice is None:
        return
    same = sorted(file for file, name in zip(files, names, strict=True) if name == twice)
    fault = f"found {len(same)} files of {twice} ({', '.join(same)}), expected one of each camera"
    if folder is None:
        raise CalibrationError(f"calibration: {fault}")
    patterns = sorted({_pattern(file, files, names) for file in files} - {""})
    how = f"--pattern '{patterns[0]}' (in Python pattern=), or " if patterns else ""
    variants = f"; variants: {', '.join(patterns)}" if patterns else ""
    raise CalibrationError(f"{folder}: {fault}{variants}; select with {how}the list of files")


def _pattern(file: str, files: Sequence[str], names: Sequence[str]) -> str:
    """Return a pattern that selects the variant of `file`, one file per camera; empty if there is none."""
    for star in ("*", "*[0-9]"):
        pattern = re.sub(r"(camera\D*?)\d+", rf"\g<1>{star}", file, count=1)
        chosen = [name for other, name in zip(files, names, strict=True) if fnmatchcase(other, pattern)]
        if pattern != file and len(chosen) == len(set(chosen)):
            return pattern
    return ""


def read_all_calibrated(
    paths: Sequence[Path], pattern: str | None = None, *, alone: bool = True
) -> tuple[Calibrated, ...]:
    """Read the given files, one per camera, or those of one folder, ordered by camera.

    `pattern`: see `calibration_files`; `alone`: see `read_calibrated`. CalibrationError: a file is malformed,
    there is no file, or there are several files of one camera.
    """
    folder = paths[0] if len(paths) == 1 and os.path.isdir(paths[0]) else None
    files = paths if folder is None else calibration_files(folder, pattern)
    found = [read_calibrated(path, alone=alone) for path in files]
    if folder is None and pattern is not None:
        raise CalibrationError(f"pattern: found {pattern!r} beside single files, expected a folder")
    names = [one.camera.name for one in found]
    _refuse_variants(folder, [str(path) if folder is None else path.name for path in files], names)
    if folder is not None:
        order = sorted(range(len(found)), key=lambda k: _order(names[k], files[k].name))
        found = [found[k] for k in order]
    return tuple(found)


def robots_in(folder: Path) -> list[str]:
    """Return the robots whose calibration files are in a folder, e.g. `r1` for r1_camera60.yml."""
    names = (file.name for file in folder.iterdir()) if folder.is_dir() else ()
    found = {match[1] for name in names if (match := re.fullmatch(r"(r\d+)_camera.*\.ya?ml", name))}
    return sorted(found, key=lambda robot: (int(robot[1:]), robot))


def pattern_of(robot: str) -> str:
    """Return the pattern of a robot's calibration files."""
    return f"{robot}_camera*.y*ml"


def focal_deviations(found: Iterable[Calibrated]) -> dict[str, float]:
    """Return the larger relative standard deviation of fx and fy by camera name, where stated."""
    return {
        one.camera.name: float((one.matrix_std[(0, 1), (0, 1)] / one.camera.matrix[(0, 1), (0, 1)]).max())
        for one in found
        if one.matrix_std is not None
    }


def halved_by_rows(path: Path) -> bool:
    """Return whether a file's principal point is c/2, from halving K[:2], instead of the correct c/2 - ¼.

    This is judged by a file of twice the size beside it, else by the name that the platform gives such files.
    Files that state standard deviations of the lens are written by this package, which halves correctly.
    """
    read = read_calibrated(path)
    mine = read.camera
    for other in path.parent.glob("*.y*ml"):
        with contextlib.suppress(CalibrationError):
            whole = read_calibrated(other).camera
            sizes = (whole.width, whole.height) == (2 * mine.width, 2 * mine.height)
            same = np.allclose(whole.matrix[(0, 1), (0, 1)], 2 * mine.matrix[(0, 1), (0, 1)], rtol=1e-9)
            if whole.name == mine.name and sizes and same:
                return np.allclose(whole.matrix[:2, 2], 2 * mine.matrix[:2, 2], atol=1e-6)
    return read.matrix_std is None and path.stem.endswith("_downsampled")
