import dataclasses

import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from tests.helpers.kept_stills import bare
from tracker.geometry.camera import BENT, CENTER, FARTHEST, FOCAL
from tracker.objects.model import Box
from tracker.pose import refine
from tracker.pose.refine import LIKELY, begin
from tracker.pose.refiner import Refiner
from tracker.pose.sizes import seeing
from tracker.pose.solution import CAMERA, SOLUTION, UNKNOWNS
from tracker.pose.views import PICTURE, Reader

MODEL = tracker.load_object("cube_v2")


def refiner_of(rig):
    box = Box.of(MODEL)
    return Refiner(box, rig, Reader(box, rig, tracker.load_colors("cube_v2")), support=False)


@pytest.fixture(scope="module")
def still(rig):
    return bare(MODEL, rig.cameras, 71)


def extreme(camera, kind):
    """A camera with one number as large as it may be."""
    matrix, transform, lens = camera.matrix.copy(), camera.camera_from_world.copy(), np.zeros(12)
    lens[:5] = camera.distortion
    if kind.startswith("c"):
        matrix["xy".index(kind[1]), 2] = CENTER * (-1 if kind.endswith("-") else 1)
    elif kind.startswith("f"):
        matrix[0, 0] = FOCAL[kind == "f+"]
    elif kind.startswith("k"):
        lens[int(kind[1:])] = BENT
    else:
        transform[2, 3] = FARTHEST
    return dataclasses.replace(camera, matrix=matrix, camera_from_world=transform, distortion=lens)


@pytest.mark.parametrize("kind", ["cx", "cy-", "f+", "f-", "k0", "k4", "k5", "k8", "k11", "far"])
@pytest.mark.parametrize("count", [1, 3])
def test_numbers_at_their_bounds_end_no_process(rig, still, kind, count):
    cameras = [extreme(camera, kind) if c < count else camera for c, camera in enumerate(rig)]
    one = tracker.ObjectTracker(MODEL, tracker.CameraRig(tuple(cameras)))
    found = one.detect(still.images)
    assert found.object_pose is None or np.isfinite(found.object_pose.covariance).all()
    one.update(still.images, 0.0)


@pytest.mark.parametrize("size", [270, 540, 1080, 2160])
def test_every_strip_in_view_has_pixels(size):
    rig = tracker.CameraRig(default_cameras(size))
    image = np.random.default_rng(1).integers(0, 256, (size, size, 3)).astype(np.uint8)
    refiner = refiner_of(rig)
    pictures = np.zeros(3, PICTURE)
    pictures["used"], pictures["address"] = True, image.__array_interface__["data"][0]
    pictures["height"], pictures["width"], pictures["mosaic"] = size, size, -1
    _, cameras, work = refiner.edges(pictures, np.eye(3), np.array([0.02, 0.01, 0.0325]))
    for c in range(3):
        strips = work.strips[c, : cameras["strips"][c]]
        assert strips["in_view"].sum() > 30
        assert (strips["count"].sum(axis=1)[strips["in_view"]] >= 8).all()


def begun(cameras, blind=()):
    """Whether stated errors count where a refinement begins, and its cameras; some have no image."""
    refiner = refiner_of(tracker.CameraRig(tuple(cameras)))
    solution, states = np.zeros(1, SOLUTION), np.zeros(len(cameras), CAMERA)
    solution["size"], solution["rotation"] = UNKNOWNS, np.eye(3)
    pictures = np.zeros(len(cameras), PICTURE)
    pictures["used"] = ~np.isin(range(len(cameras)), blind)
    return begin(refiner.model, pictures, solution[0], states, LIKELY), states


def test_cameras_whose_errors_are_not_stated_are_exact(rig):
    silent = [dataclasses.replace(camera, camera_from_world_std=None) for camera in rig]
    assert begun(silent)[0] is False
    for stated in (slice(0), np.s_[:3, :3], np.s_[:3, 3], np.s_[:3]):  # none, rotations, translations, all
        std = np.zeros((4, 4))
        std[stated] = 1e-3
        cameras = [dataclasses.replace(camera, camera_from_world_std=std) for camera in rig]
        assert begun(cameras)[0] is bool(std.any())


def test_cameras_at_one_place_see_alike_and_those_around_hardly(rig):
    def alike(*cameras, blind=()):
        named = [dataclasses.replace(camera, name=f"camera{k}") for k, camera in enumerate(cameras)]
        states = begun(named, blind)[1]
        states["whole"][states["used"], 0, 0] = 1.0
        return seeing(states)[1]

    assert alike(*rig, blind=(1, 2)) == pytest.approx(1.0)
    assert alike(*[rig.cameras[0]] * 3) == pytest.approx(3.0)
    assert alike(*[rig.cameras[0]] * 3, blind=(1,)) == pytest.approx(2.0)
    assert 1.0 < alike(*rig) < 2.0


def test_a_pose_that_cannot_be_written_compiles_nothing_again(rig, still):
    one = tracker.ObjectTracker(MODEL, rig)
    fit, sight = one.fit(still.images), one._estimator.reader(still.images)
    before = len(refine.refine.signatures)
    rotation, position = fit.rotation.copy(), fit.position.copy()
    rotation.flags.writeable = position.flags.writeable = False
    again = one._estimator.refiner(sight, rotation, position)
    assert np.linalg.norm(again.position - fit.position) < 1e-3
    assert len(refine.refine.signatures) == before == 1
