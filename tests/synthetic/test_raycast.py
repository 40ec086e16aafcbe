"""The ray-cast reference against OpenCV's projection, closed forms and its own promises."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.raycast import Rendering, kernels, render, renderer
from synthetic.raycast.fingers import Capsule
from synthetic.raycast.records import CAPSULE
from synthetic.raycast.scene import Scene, face_colors, random_scene
from tracker.conventions import Array
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, FACE_NORMALS, corners
from tracker.objects.model import CuboidModel, load_object

CAMERAS = default_cameras()
MODELS = (load_object("cube_v1"), load_object("cube_v2"), load_object("cuboid_2x2x8_v2"))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def picture(scene: Scene, model: CuboidModel, cameras: tuple[Camera, ...] = CAMERAS) -> Rendering:
    return render(scene, cameras, model, Sensor.clean(), rng())


def project(camera: Camera, points: Array) -> Array:
    """Pixels (N, 2) by OpenCV alone."""
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    rvec, _ = cv2.Rodrigues(rotation.copy())
    return cv2.projectPoints(points, rvec, translation, camera.matrix, camera.distortion)[0].reshape(-1, 2)


def face_outlines(scene: Scene, model: CuboidModel, camera: Camera) -> list[Array]:
    """Pixels (N, 2) along the outline of each visible face; edges sampled finely, as lenses bend them."""
    outlines = []
    points = corners(model.size) @ scene.rotation.T + scene.position
    eye = np.linalg.inv(camera.camera_from_world)[:3, 3]
    share = np.linspace(0, 1, 40, endpoint=False)[:, None]
    for normal, ring in zip(FACE_NORMALS @ scene.rotation.T, points[FACE_CORNERS], strict=True):
        if normal @ (eye - ring[0]) > 0:
            outline = [a + share * (b - a) for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)]
            outlines.append(project(camera, np.concatenate(outline)))
    return outlines


def area_and_centroid(outlines: list[Array]) -> tuple[float, Array]:
    area, moment = 0.0, np.zeros(2)
    for a in outlines:
        b = np.roll(a, -1, axis=0)
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        area += abs(cross.sum() / 2)
        moment += np.sign(cross.sum()) * ((a + b) * cross[:, None]).sum(axis=0) / 6
    return area, moment / area


def is_inside(outlines: list[Array], camera: Camera) -> bool:
    pixels = np.concatenate(outlines)
    return bool((pixels > 1).all() and (pixels < [camera.width - 2, camera.height - 2]).all())


@pytest.mark.parametrize("width", [270, 540])
def test_object_covers_what_opencv_projects(width: int) -> None:
    cameras = default_cameras(width)
    shifts, areas = [], []
    for seed in range(20 if width == 270 else 2):
        model = MODELS[seed % len(MODELS)]
        scene = random_scene(model, rng(seed), occlusion=0, in_air=0.5)
        for camera, coverage in zip(cameras, picture(scene, model, cameras).coverage, strict=True):
            outlines = face_outlines(scene, model, camera)
            if not is_inside(outlines, camera):
                continue
            hull = cv2.convexHull(np.concatenate(outlines).astype(np.float32))
            for row, column in np.argwhere(coverage > 0):
                assert cv2.pointPolygonTest(hull, (float(column), float(row)), True) > -1
            area, centroid = area_and_centroid(outlines)
            rows, columns = np.indices(coverage.shape)
            found = np.array([(columns * coverage).sum(), (rows * coverage).sum()]) / coverage.sum()
            shifts.append(found - centroid)
            areas.append(coverage.sum() / area - 1)
    assert len(shifts) > 3
    assert np.linalg.norm(shifts, axis=1).mean() < 0.01
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.002
    assert np.abs(areas).mean() < 0.001


def test_rays_between_nodes_hit_their_pixels() -> None:
    camera = CAMERAS[0]
    nodes = renderer._ray_nodes(camera)
    count, step = renderer._OBJECT_LATTICE
    weights = renderer._lattice_weights(count, step)
    n = np.arange(count)
    offsets = np.stack([(n + 0.5) / count, ((n * step) % count + 0.5) / count], axis=1) - 0.5
    lens = camera.matrix, camera.distortion
    for column, row in ((0, 0), (269, 3), (134, 135), (40, 250)):
        around = nodes[2 * row : 2 * row + 3, 2 * column : 2 * column + 3].reshape(9, 2)
        rays = np.insert(weights @ around, 2, 1.0, axis=1)
        pixels = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), *lens)[0].reshape(-1, 2)
        np.testing.assert_allclose(pixels, offsets + np.array([column, row]), atol=1e-5)


def test_lens_without_inverse_is_refused() -> None:
    camera = dataclasses.replace(CAMERAS[0], distortion=np.array([-3.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(CalibrationError, match="camera60: the lens has no inverse"):
        picture(random_scene(MODELS[0], rng()), MODELS[0], (camera,))


def test_camera_of_twice_the_width_sees_the_same() -> None:
    for small, large in zip(CAMERAS, default_cameras(540), strict=True):
        points = rng().uniform(-0.1, 0.1, (20, 3))
        np.testing.assert_allclose(project(large, points), 2 * project(small, points) + 0.5, atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_faces_lie_on_their_axes(model: CuboidModel) -> None:
    camera = CAMERAS[1]
    eye = np.linalg.inv(camera.camera_from_world)[:3, 3]
    position = np.array([0.01, -0.02, 0.06])
    for face, normal in enumerate(FACE_NORMALS):
        towards = (eye - position) / np.linalg.norm(eye - position)
        side = np.cross(towards, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        in_world = np.stack([towards, side, np.cross(towards, side)], axis=1)
        in_object = np.stack([normal, np.roll(normal, 1), np.cross(normal, np.roll(normal, 1))], axis=1)
        rotation = in_world @ in_object.T
        scene = random_scene(model, rng(face), occlusion=0)
        result = picture(dataclasses.replace(scene, position=position, rotation=rotation), model, (camera,))
        column, row = np.rint(project(camera, position[None])[0]).astype(int)
        assert result.labels[0][row, column] == model.face_labels[face]
        color = result.images[0][row, column].astype(float)
        known = face_colors(model)[1:]
        cosine = known @ color / np.linalg.norm(known, axis=1)
        assert np.argmax(cosine) + 1 == model.face_labels[face]


def test_same_seed_gives_same_pixels() -> None:
    def shoot(scene_seed: int, sensor_seed: int) -> Rendering:
        scene = random_scene(MODELS[1], rng(scene_seed))
        return render(scene, CAMERAS[:1], MODELS[1], Sensor.realistic(), rng(sensor_seed))

    first, again, noise, other = shoot(1, 1), shoot(1, 1), shoot(1, 2), shoot(2, 1)
    assert np.array_equal(first.images[0], again.images[0])
    assert not np.array_equal(first.images[0], noise.images[0])
    assert np.array_equal(first.labels[0], noise.labels[0])
    assert not np.array_equal(first.labels[0], other.labels[0])


def test_fingers_hide_a_part_of_the_object() -> None:
    fractions = []
    for seed in range(8):
        model = MODELS[seed % len(MODELS)]
        scene = random_scene(model, rng(seed))
        result = picture(scene, model)
        without = picture(dataclasses.replace(scene, fingers=(), motors=()), model)
        for seen, whole, fraction in zip(result.labels, without.labels, result.visible_fraction, strict=True):
            assert (whole[seen > 0] == seen[seen > 0]).all()
            assert fraction == pytest.approx((seen > 0).sum() / max((whole > 0).sum(), 1))
        assert (without.visible_fraction == 1).all()
        fractions.append(result.visible_fraction)
    assert 0 <= np.min(fractions) < 0.5
    assert 0.6 < np.median(fractions) < 0.95


def test_fingers_do_not_reach_into_the_object() -> None:
    for seed in range(60):
        model = MODELS[seed % len(MODELS)]
        scene = random_scene(model, rng(seed), occlusion=1)
        inside = rng(seed).uniform(-0.5, 0.5, (2000, 3)) * model.size @ scene.rotation.T + scene.position
        for capsule in scene.fingers:
            axis = capsule.end - capsule.start
            share = np.clip((inside - capsule.start) @ axis / max(axis @ axis, 1e-12), 0, 1)
            distance = np.linalg.norm(inside - capsule.start - share[:, None] * axis, axis=1)
            assert (distance > capsule.radii[0] + share * (capsule.radii[1] - capsule.radii[0])).all()


@pytest.mark.parametrize("in_air", [0, 1])
def test_objects_stay_above_the_table_and_within_the_arena(in_air: float) -> None:
    for seed in range(100):
        model = MODELS[seed % len(MODELS)]
        scene = random_scene(model, rng(seed), in_air=in_air, on_edge=0.5)
        np.testing.assert_allclose(scene.rotation @ scene.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(scene.rotation) == pytest.approx(1)
        points = corners(model.size) @ scene.rotation.T + scene.position
        assert -1e-12 <= points[:, 2].min() <= 0.1 * in_air + 1e-12
        assert np.hypot(points[:, 0], points[:, 1]).max() < 0.19


def test_empty_arena_has_no_labels() -> None:
    result = picture(random_scene(MODELS[0], rng(), object_present=False), MODELS[0])
    assert result.position is None
    assert result.rotation is None
    assert not any(labels.any() for labels in result.labels)
    assert not any(coverage.any() for coverage in result.coverage)
    assert not result.visible_fraction.any()


def march(capsule: Capsule, origin: Array, direction: Array) -> float:
    """Distance to a capsule by steps of the distance to its nearest sphere; infinity for a miss."""
    share = np.linspace(0, 1, 20001)
    centers = capsule.start + share[:, None] * (capsule.end - capsule.start)
    radii = capsule.radii[0] + share * (capsule.radii[1] - capsule.radii[0])
    travelled = 0.0
    while travelled < 2:
        gap = (np.linalg.norm(centers - origin - travelled * direction, axis=1) - radii).min()
        if gap < 1e-7:
            return travelled
        travelled += gap
    return np.inf


def test_capsules_are_hit_where_marching_arrives() -> None:
    draw = rng(3)
    hits = 0
    for trial in range(60):
        start, end = draw.uniform(-0.1, 0.1, (2, 3))
        radii = tuple(draw.uniform(0.005, 0.05, 2))
        capsule = Capsule(start, start if trial % 10 == 0 else end, radii, np.ones(3))
        origin = draw.normal(0, 1, 3)
        origin *= 0.5 / np.linalg.norm(origin)
        if trial % 3 == 0:  # nearly along the axis
            origin = end + 0.4 * (end - start) / np.linalg.norm(end - start) + draw.normal(0, 0.01, 3)
        direction = (start + end) / 2 + draw.normal(0, 0.02, 3) - origin
        direction /= np.linalg.norm(direction)
        record = renderer._records((capsule,), CAPSULE)[0]
        distance, _ = kernels._hit_capsule(record, *origin, *direction)
        expected = march(capsule, origin, direction)
        assert distance == pytest.approx(expected, abs=2e-5)
        hits += np.isfinite(expected)
    assert 20 < hits < 60


def test_clean_sensor_only_rounds_a_flat_field() -> None:
    flat = np.full((20, 30, 3), [0.2, 0.5, 0.8], np.float32)
    assert (Sensor.clean().expose(flat, rng()) == [51, 128, 204]).all()
    assert (dataclasses.replace(Sensor.clean(), path="new").expose(flat, rng()) == [51, 128, 204]).all()


def test_noise_follows_its_formula() -> None:
    sensor = Sensor(full_well=10_000, read_noise=2.0)
    for level in (0.2, 0.8):
        image = sensor.expose(np.full((300, 300, 3), level, np.float32), rng())
        expected = np.sqrt(2.0**2 + 255 * level * 255 / 10_000 + 1 / 12)
        assert image.std() == pytest.approx(expected, rel=0.02)
        assert image.mean() == pytest.approx(255 * level, abs=0.05)


def test_blur_keeps_light_and_place() -> None:
    spot = np.zeros((21, 21, 3), np.float32)
    spot[10, 8] = 4.0
    image = Sensor(psf_sigma=1.2).expose(spot, rng())[:, :, 0].astype(float)
    rows, columns = np.indices(image.shape)
    assert (image * columns).sum() / image.sum() == pytest.approx(8, abs=1e-9)
    assert (image * rows).sum() / image.sum() == pytest.approx(10, abs=1e-9)
    assert image.sum() == pytest.approx(4 * 255, rel=0.02)


def test_cameras_differ_in_color_and_brightness_as_allowed() -> None:
    sensor = Sensor(exposure=(0.6, 1.4), white_balance=0.2)
    flat = np.full((4, 4, 3), 0.4, np.float32)
    means = np.array([sensor.expose(flat, rng(seed)).mean(axis=(0, 1)) for seed in range(200)]) / (0.4 * 255)
    assert means.min() > 0.6 / 1.2 - 0.01
    assert means.max() < 1.4 * 1.2 + 0.01
    ratio = means[:, 0] / means[:, 2]
    assert ratio.min() < 0.8
    assert ratio.max() > 1.25
