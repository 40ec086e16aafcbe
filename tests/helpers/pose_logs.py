"""Made-up poses for the tests of what is written about them."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.helpers import make_rig
from tracker import CameraUse
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.poses.file import PosesBuilder
from tracker.poses.poses import About, Poses

START = 1.6e9 + 0.125
"""Time of the first frame [s]."""


def make_about(**changes: Any) -> About:
    values = {"object_name": "cube_v2", "source": "a.dat", "tracker_version": "0.1", "rig": make_rig()}
    return About(**values | changes)


def random_covariance(rng: np.random.Generator) -> FloatArray:
    """(6, 6), of full rank or less, over many sizes, symmetric to the bit."""
    root = rng.normal(size=(6, rng.integers(1, 8))) * 10.0 ** rng.uniform(-5, 0, size=(6, 1))
    product = root @ root.T
    return (product + product.T) / 2


def random_pose(rng: np.random.Generator, moving: bool = False) -> SimpleNamespace:
    quaternion = rng.normal(size=4)
    pose = SimpleNamespace(
        position=rng.normal(scale=0.1, size=3),
        orientation=quaternion / np.linalg.norm(quaternion),
        covariance=random_covariance(rng),
        confidence=rng.uniform(),
    )
    if moving:
        pose.velocity = rng.normal(size=6)
        pose.velocity_covariance = random_covariance(rng)
    return pose


def answer(measured: Any, filtered: Any, status: str, cameras: Sequence[Any] = ()) -> SimpleNamespace:
    return SimpleNamespace(
        object_pose=measured,
        filtered_object_pose=filtered,
        status=SimpleNamespace(value=status),
        cameras=cameras,
    )


def random_poses(
    rng: np.random.Generator,
    count: int,
    *,
    share: float | Sequence[float] = 0.7,
    recorded: bool = True,
    first: int = 0,
    cameras: bool = True,
) -> Poses:
    """`count` frames; each kind of pose is there in a `share` of them, as is what became of the pictures.

    With one `share` for each frame, it is the probability there.
    """
    builder = PosesBuilder(make_about())
    for number, likely in enumerate(np.broadcast_to(share, count), start=first):
        measured, filtered, old = (rng.uniform() < likely for _ in range(3))
        status = "tracking" if measured else "coasting" if filtered else "lost"
        uses = rng.choice([use.value for use in CameraUse], 3) if cameras and rng.uniform() < likely else ()
        poses = (random_pose(rng) if measured else None, random_pose(rng, moving=True) if filtered else None)
        before = random_pose(rng) if recorded and old else None
        builder.append(number, START + number / 10, answer(*poses, status, uses), before)
    return builder.build()


def moved(rotation: FloatArray, position: FloatArray, confidence: float = 0.9) -> SimpleNamespace:
    """A recorded pose."""
    quaternion = so3.quaternion_from_matrix(rotation)
    return SimpleNamespace(position=position, orientation=quaternion, confidence=confidence)


def arrays_of(poses: Poses) -> dict[str, np.ndarray]:
    """All arrays by name."""
    result = {"index": poses.index, "timestamp": poses.timestamp, "status": poses.status}
    if poses.cameras is not None:
        result["cameras"] = poses.cameras
    for kind in ("measured", "filtered", "recorded"):
        columns = getattr(poses, kind)
        for name, array in columns.arrays().items() if columns is not None else ():
            result[f"{kind}/{name}"] = array
    return result


def assert_same(first: Poses, second: Poses) -> None:
    """The same to the bit."""
    assert first.about.rig.agrees_with(second.about.rig)
    for name in ("object_name", "source", "tracker_version"):
        assert getattr(first.about, name) == getattr(second.about, name)
    one, two = arrays_of(first), arrays_of(second)
    assert one.keys() == two.keys()
    for name, array in one.items():
        assert array.shape == two[name].shape, name
        if name in ("status", "cameras"):
            assert array.tolist() == two[name].tolist()
        else:
            assert array.dtype == two[name].dtype, name
            assert array.tobytes() == two[name].tobytes(), name
