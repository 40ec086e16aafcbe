import dataclasses

import cv2
import numpy as np
import pytest
from numpy.random import default_rng as rng
from scipy.ndimage import center_of_mass

from synthetic.camera.lens import Lens
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.look.face_colors import reflectances
from synthetic.render.hits import labels_of_codes
from synthetic.render.raster import paint
from synthetic.render.renderer import render
from synthetic.render.surfaces import surfaces_of
from synthetic.scene import ObjectState
from tests.helpers import look_at, opencv_pixels
from tests.helpers.stills import bare_scene, posed_scene, scene_with_fingers, take
from tracker import Camera, CuboidModel, load_object
from tracker.conventions import Array
from tracker.geometry.cuboid import FACE_CORNERS, FACE_NORMALS, corners

CAMERAS = default_cameras()
MODELS = (load_object("cube_v1"), load_object("cube_v2"), load_object("cuboid_2x2x8_v2"))


def face_outlines(state: ObjectState, model: CuboidModel, camera: Camera) -> list[Array]:
    """Pixels (N, 2) along the outline of each visible face; edges sampled finely, as lenses bend them."""
    outlines = []
    points = corners(model.size) @ state.rotation.T + state.position
    share = np.linspace(0, 1, 40, endpoint=False)[:, None]
    for normal, ring in zip(FACE_NORMALS @ state.rotation.T, points[FACE_CORNERS], strict=True):
        if normal @ (camera.position - ring[0]) > 0:
            outline = [a + share * (b - a) for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)]
            outlines.append(opencv_pixels(camera, np.concatenate(outline)))
    return outlines


@pytest.mark.parametrize(("width", "scenes"), [(270, 10), (540, 2)])
def test_object_covers_what_opencv_projects(width: int, scenes: int) -> None:
    shifts, areas = [], []
    for seed in range(scenes):
        model = MODELS[seed % len(MODELS)]
        scene = bare_scene(model, rng(seed), kind=("rest", "air")[seed % 2])
        bodies = [(n, body.mesh, body.world_from_body) for n, body in enumerate(scene.bodies)]
        for camera in default_cameras(width):
            lens = Lens(camera, 4 * 270 // width)
            layer = labels_of_codes(paint(lens.view, bodies)[0], surfaces_of(scene)) > 0
            coverage = lens.to_camera(layer, "mean")  # the share of each pixel that the object covers
            outlines = face_outlines(scene.objects[0], model, camera)
            pixels = np.concatenate(outlines)
            if pixels.min() <= 1 or pixels.max() >= width - 2:
                continue
            hull = cv2.convexHull(pixels.astype(np.float32))
            covered = np.argwhere(coverage > 0)[:, ::-1]
            for ((column, row),) in cv2.convexHull(covered.astype(np.int32)).tolist():
                assert cv2.pointPolygonTest(hull, (float(column), float(row)), True) > -1
            moments = [cv2.moments(outline.astype(np.float32)) for outline in outlines]
            area, *along = (sum(part[key] for part in moments) for key in ("m00", "m10", "m01"))
            shifts.append(center_of_mass(coverage)[::-1] - np.array(along) / area)
            areas.append(coverage.sum() / area - 1)
    assert len(shifts) > 3
    assert np.linalg.norm(shifts, axis=1).mean() < 0.01
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.002
    assert np.abs(areas).mean() < 0.001


def test_camera_of_twice_the_width_sees_the_same() -> None:
    points = rng(0).uniform(-0.1, 0.1, (20, 3))
    for small, large in zip(CAMERAS, default_cameras(540), strict=True):
        expected = 2 * opencv_pixels(small, points) + 0.5
        np.testing.assert_allclose(opencv_pixels(large, points), expected, atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_faces_lie_on_their_axes(model: CuboidModel) -> None:
    camera, position = CAMERAS[1], np.array([0.01, -0.02, 0.06])
    # Columns towards the camera, to its side, and perpendicular to both.
    in_world = look_at(position, camera.position)[(2, 0, 1), :3].T
    for face, normal in enumerate(FACE_NORMALS):
        in_object = np.stack([normal, np.roll(normal, 1), np.cross(normal, np.roll(normal, 1))], axis=1)
        rotation = in_world @ in_object.T
        scene = posed_scene(model, (position, rotation), rng(face))
        result = take(scene, (camera,), Sensor.clean(), rng(0))
        column, row = np.rint(opencv_pixels(camera, position[None])[0]).astype(int)
        assert result.labels[0][row, column] == model.face_labels[face]
        color = result.images[0][row, column].astype(float)
        known = np.sqrt(reflectances(model.colors)[1:])
        cosine = known @ color / np.linalg.norm(known, axis=1)
        assert np.argmax(cosine) + 1 == model.face_labels[face]


def test_fingers_hide_a_part_of_the_object() -> None:
    fractions = []
    for seed in range(24):
        scene = scene_with_fingers(MODELS[seed % len(MODELS)], rng(seed))
        # One point a pixel: with more, a finger may leave most of the rest of a pixel to another face.
        result = take(scene, CAMERAS, Sensor.clean(), rng(0), points=1)
        fractions.append(result.visible_fraction)
        if seed >= 6:
            continue
        own = tuple(b for b in scene.bodies if b.name in {"table", "wall", "floor", scene.objects[0].name})
        bare = dataclasses.replace(scene, bodies=own)
        without = take(bare, CAMERAS, Sensor.clean(), rng(0), points=1)
        for seen, whole, fraction in zip(result.labels, without.labels, result.visible_fraction, strict=True):
            assert (whole[seen > 0] == seen[seen > 0]).all()
            assert fraction == pytest.approx((seen > 0).sum() / max((whole > 0).sum(), 1))
        assert (without.visible_fraction == 1).all()
    assert 0 <= np.min(fractions) < 0.5
    assert 0.6 < np.median(fractions) < 0.95


def test_pixels_that_share_a_look_have_the_same_labels_and_almost_the_same_light() -> None:
    scene, lens = scene_with_fingers(MODELS[1], rng(3)), Lens(CAMERAS[0], 3)
    each, some = (
        render(scene, dataclasses.replace(lens.view, block=block), shadows=True) for block in (1, 3)
    )
    assert np.array_equal(each.labels, some.labels)
    assert np.array_equal(each.alone, some.alone)
    apart = np.abs(lens.to_camera(each.color, "mean") - lens.to_camera(some.color, "mean"))
    assert np.median(apart) < 1e-3
    assert np.quantile(apart, 0.99) < 0.03
