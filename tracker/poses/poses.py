"""Poses of all frames of a recording, with what they were made from."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import LATEST, Frozen, described, float_array, freeze, is_whole, of_kind, optional
from tracker.conventions import Array, FloatArray
from tracker.errors import LogError, shown
from tracker.geometry import cuboid, so3
from tracker.objects.model import CuboidModel
from tracker.poses.columns import FilteredColumns, MeasuredColumns, PoseColumns, refuse

CAMERA_SEPARATOR = "|"
"""Separator between the uses of the cameras' images in the column `cameras`."""

_AXES = {3: "axis", 4: "xyzw", 6: "twist"}
"""Names of array axes by length."""

Kind = Literal["measured", "filtered", "recorded"]
"""Kind of a frame's pose."""

KINDS: dict[Kind, type[PoseColumns]] = {
    "measured": MeasuredColumns,
    "filtered": FilteredColumns,
    "recorded": PoseColumns,
}
"""Type of the columns of each kind of pose."""

_TWIST = ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s", "wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s")
_CELLS = {
    "position": ("x_m", "y_m", "z_m"),
    "orientation": ("qx", "qy", "qz", "qw"),
    "confidence": ("confidence",),
    "covariance": ("std_x_m", "std_y_m", "std_z_m", "std_rx_rad", "std_ry_rad", "std_rz_rad"),
    "velocity": _TWIST,
    "velocity_covariance": tuple(f"std_{name}" for name in _TWIST),
}
"""Table columns for each column of poses; covariances give standard deviations."""


@dataclass(frozen=True, eq=False)
class About:
    """What the poses were made from, and by which version; LogError if a text cannot be stored."""

    object_name: str
    """The object, e.g. `cube_v2`."""
    source: str
    """The recording, e.g. the name of its file."""
    tracker_version: str
    """Version of this package."""
    rig: CameraRig
    """The cameras, as they were calibrated."""
    fingerprint: str = ""
    """Hash of recording, object, calibration, options and code; empty: unknown."""
    fault: str = ""
    """Fault of a damaged recording, of which only these poses could be recovered; empty: no fault."""

    def __post_init__(self) -> None:
        for name in ("object_name", "source", "tracker_version", "fingerprint", "fault"):
            value = getattr(self, name)
            # Python represents bytes of file names that are not UTF-8 as lone surrogates.
            if not isinstance(value, str) or re.search("[\0\ud800-\udfff]", value):
                found = f"{name}: found {ascii(value)[:80]}"
                raise LogError(f"{found}, expected Unicode text without null characters")


@dataclass(frozen=True, eq=False)
class Poses(Frozen):
    """Poses of n frames in columns. Arrays are copied and read-only.

    `poses[10:20]` and `poses[mask]` are the poses of some of the frames.

    Attributes:
        index: (n,) int64: increasing frame numbers; the recording's first frame is 0.
        timestamp: (n,) time of each frame [s].
        status: (n,) text: status of each frame, a value of `tracker.Status`.
        measured: poses measured in the images of each single frame.
        filtered: poses fused over time, with velocities.
        recorded: poses stored in the recording; None if it has none at all.
        about: what the poses were made from.
        cameras: (n, C) text: use of each camera's image in the order of the rig, a value of
            `tracker.CameraUse`, or empty if unknown. None if all are unknown.

    Raises:
        LogError: columns differ in length, or contain impossible values.
    """

    index: Array
    timestamp: FloatArray
    status: Array
    measured: MeasuredColumns
    filtered: FilteredColumns
    recorded: PoseColumns | None
    about: About
    cameras: Array | None = None

    def __post_init__(self) -> None:
        index = np.array(self.index)
        if index.ndim != 1 or (index.size and index.dtype.kind not in "iu"):
            raise LogError(f"index: found {described(index)}, expected whole numbers of shape (n,)")
        freeze(self, "index", index.astype(np.int64))
        count = len(index)
        bad = np.diff(self.index, prepend=-1) <= 0
        refuse("index", bad, self.index, "frame numbers from 0 on that increase")
        freeze(self, "timestamp", float_array(self.timestamp, (count,), "timestamp", LogError, finite=False))
        bad = ~(np.abs(self.timestamp) <= LATEST)
        refuse("timestamp", bad, self.timestamp, f"a time in seconds, up to {LATEST:g}")
        freeze(self, "status", _texts("status", self.status, (count,)))
        if self.cameras is not None:
            freeze(self, "cameras", _texts("cameras", self.cameras, (count, len(self.about.rig))))
        for kind, columns_type in KINDS.items():
            columns: object = getattr(self, kind)
            if kind == "recorded" and columns is None:
                continue
            if type(columns) is not columns_type:
                found = type(columns).__name__
                raise LogError(f"{kind}: found {found}, expected {columns_type.__name__}")
            if len(columns) != count:
                raise LogError(f"{kind}: found {len(columns)} frames, expected {count}")

    def __repr__(self) -> str:
        measured = np.count_nonzero(self.measured.has_pose)
        seconds = f" over {self.timestamp[-1] - self.timestamp[0]:.1f} s" if len(self) else ""
        return (
            f"Poses({self.about.object_name} in {self.about.source!r}: {len(self)} frames{seconds}, "
            f"{measured} with a measured and {np.count_nonzero(self.filtered.has_pose)} with a filtered pose)"
        )

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, rows: slice | Array) -> Poses:
        if is_whole(rows):
            raise LogError(f"frames of poses: found the number {rows}, expected a slice, a mask or numbers")
        parts: dict[str, Any] = {
            name: one[rows] for name, one in vars(self).items() if isinstance(one, PoseColumns | np.ndarray)
        }
        # A part of what one run made must not count as its result.
        return replace(self, **parts, about=replace(self.about, fingerprint=""))

    def table(self, keypoints_of: CuboidModel | None = None) -> dict[str, Array]:
        """Return columns (n,): numbers, NaN if missing, and texts. Names are the same for every recording.

        keypoints_of: an object whose corners to add as columns, such as `filtered_keypoint0_x_m`.
        """
        table: dict[str, Array] = {"frame": self.index, "timestamp_s": self.timestamp, "status": self.status}
        for kind in KINDS:
            columns = self._known(kind)
            for name in columns.ROW_SHAPES:
                values = getattr(columns, name)
                if values.ndim == 3:
                    values = np.sqrt(np.diagonal(values, axis1=1, axis2=2))
                rows = values.reshape(len(self), len(_CELLS[name]))
                table |= {f"{kind}_{cell}": rows[:, k] for k, cell in enumerate(_CELLS[name])}
        given = [[]] * len(self) if self.cameras is None else self.cameras.tolist()
        uses = [CAMERA_SEPARATOR.join(row) if any(row) else "" for row in given]
        table["cameras"] = np.array(uses, dtype=np.str_)
        corners = {
            f"{kind}_keypoint{i}_{axis}_m": points[:, i, k]
            for kind, points in self.keypoints(keypoints_of).items()
            for i in range(8)
            for k, axis in enumerate("xyz")
        }
        return table | corners

    def keypoints(self, model: CuboidModel | None) -> dict[Kind, FloatArray]:
        """Return corners (n, 8, 3) [m] of the object for each kind of poses, NaN if missing; {} for None.

        Corner i is on the + side of the object's x, y, z axis if bit 0, 1, 2 of i is 0. LogError: the model
        is not a CuboidModel.
        """
        if model is None:
            return {}
        of_kind(model, CuboidModel, "keypoints", LogError, "tracker.load_object")
        known = {kind: self._known(kind) for kind in KINDS}
        return {kind: cuboid.keypoints(one.position, one.rotation, model.size) for kind, one in known.items()}

    def to_dataframe(self, keypoints_of: CuboidModel | None = None) -> Any:
        """Return a pandas DataFrame with the columns of `table`; TrackerError if pandas is missing."""
        return optional("pandas", None, "this").DataFrame(self.table(keypoints_of)).set_index("frame")

    def to_xarray(self, keypoints_of: CuboidModel | None = None) -> Any:
        """Return an xarray Dataset along `frame` of whole vectors and covariances, e.g. `filtered_position`.

        keypoints_of: an object whose corners to add as variables, such as `filtered_keypoints`.
        TrackerError: the package xarray is missing.
        """
        variables: dict[str, Any] = {"timestamp": ("frame", self.timestamp), "status": ("frame", self.status)}
        if self.cameras is not None:
            variables["cameras"] = (("frame", "camera"), self.cameras)
        for kind in KINDS:
            columns: PoseColumns | None = getattr(self, kind)
            for name, array in {} if columns is None else columns.arrays().items():
                axes = [_AXES[size] + ("_too" if k else "") for k, size in enumerate(array.shape[1:])]
                variables[f"{kind}_{name}"] = (("frame", *axes), array)
        for kind, points in self.keypoints(keypoints_of).items():
            variables[f"{kind}_keypoints"] = (("frame", "keypoint", "axis"), points)
        coordinates = {
            "frame": self.index,
            "axis": list("xyz"),
            "xyzw": list("xyzw"),
            "camera": list(self.about.rig.names),
        }
        about = {name: getattr(self.about, name) for name in ("object_name", "source", "tracker_version")}
        return optional("xarray", None, "this").Dataset(variables, coords=coordinates, attrs=about)

    def _known(self, kind: Kind) -> PoseColumns:
        """Return the poses of one kind; frames without poses if the recording has none."""
        columns: PoseColumns | None = getattr(self, kind)
        return PoseColumns.nothing(len(self)) if columns is None else columns

    def columns(self, kind: Kind) -> PoseColumns:
        """Return the poses of one kind; LogError if there is no such kind, or there are none recorded."""
        if not isinstance(kind, str) or kind not in KINDS:
            raise LogError(f"kind of poses: found {shown(kind)}, expected one of {', '.join(KINDS)}")
        columns: PoseColumns | None = getattr(self, kind)
        if columns is None:
            raise LogError(f"{self.about.source}: found no recorded poses, expected measured or filtered")
        return columns


def _texts(name: str, value: object, shape: tuple[int, ...]) -> Array:
    texts = np.array(value)
    if texts.shape != shape or (texts.size and texts.dtype.kind != "U"):
        raise LogError(f"{name}: found {described(texts)}, expected texts of shape {shape}")
    return texts.astype(np.str_)


def compare(found: PoseColumns, recorded: PoseColumns) -> dict[str, float | None]:
    """Compare poses with the recorded ones of the same frames.

    Returns:
        `frames`: number of frames; `position_median_mm`, `position_p90_mm`, `angle_median_deg` and
        `angle_p90_deg` of the differences in frames with both poses, None if there are none; `share_both`,
        `share_only_found`, `share_only_recorded` and `share_neither` of all frames, None without frames.
    """
    both = found.has_pose & recorded.has_pose
    ours, theirs = found[both], recorded[both]
    distance = 1e3 * np.linalg.norm(ours.position - theirs.position, axis=1)
    angle = np.degrees(so3.angle_between(ours.rotation, theirs.rotation))
    quantiles = {"median": 0.5, "p90": 0.9}
    shares = {
        "both": both,
        "only_found": found.has_pose & ~recorded.has_pose,
        "only_recorded": ~found.has_pose & recorded.has_pose,
        "neither": ~found.has_pose & ~recorded.has_pose,
    }
    return {
        "frames": len(found),
        **{f"position_{key}_mm": _quantile(distance, share) for key, share in quantiles.items()},
        **{f"angle_{key}_deg": _quantile(angle, share) for key, share in quantiles.items()},
        **{f"share_{key}": float(np.mean(some)) if len(some) else None for key, some in shares.items()},
    }


def _quantile(values: Array, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None
