from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from synthetic.camera.lens import Lens
from synthetic.camera.rigs import default_cameras
from synthetic.errors import RendererError
from synthetic.render.check import labels_and_depth
from synthetic.render.choose import choose_renderer
from synthetic.render.interface import Layers
from synthetic.scene import Body, Lamp, Lighting, Mesh, PlatformScene
from tests.helpers import random_rotations
from tests.helpers.needs import lack
from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, FACE_NORMALS, corners

SIZES = ((0.065, 0.065, 0.065), (0.02, 0.08, 0.02))
LABELS = np.array([1, 6, 2, 5, 3, 4], np.uint8)  # +x … -z, none twice
COLORS = np.array([[1, 1, 10], [1, 9, 9], [2, 8, 2], [7, 2, 7], [9, 2, 1], [8, 7, 1]]) / 20
WHITE = np.ones(3)


RENDERER = choose_renderer()


def box(size: tuple[float, ...]) -> Mesh:
    triangles = np.concatenate([FACE_CORNERS[:, [0, 1, 2]], FACE_CORNERS[:, [0, 2, 3]]])
    return Mesh(f"box {size}", corners(np.array(size)), triangles, np.tile(np.arange(6), 2))


def ball(radius: float = 0.02) -> Mesh:
    trimesh = pytest.importorskip("trimesh", reason="platform: no module trimesh")
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh("ball", sphere.vertices, sphere.faces, np.zeros(len(sphere.faces), int))


def placed(rotation: Array, position: Array) -> FloatArray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def lighting(ambient: float = 0.5, *lamps: Lamp) -> Lighting:
    return Lighting(ambient * WHITE, lamps)


def lamp(x: float, y: float, z: float, strength: float = 0.5) -> Lamp:
    return Lamp(np.array([x, y, z]) / np.linalg.norm([x, y, z]), strength * WHITE)


def cuboid(size: tuple[float, ...], rotation: Array, position: Array) -> Body:
    return Body("object", box(size), placed(rotation, position), COLORS, LABELS, gloss=0.1, texture=0.1)


def thing(name: str, mesh: Mesh, position: Array, reflectance: float = 0.5) -> Body:
    groups = int(mesh.groups.max()) + 1
    pose = placed(np.eye(3), position)
    return Body(name, mesh, pose, np.full((groups, 3), reflectance), np.zeros(groups, np.uint8))


def crowded(rotation: Array) -> PlatformScene:
    bodies = [cuboid(SIZES[0], rotation, [0.02, -0.01, 0.06])]
    bodies.append(thing("table", box((0.5, 0.5, 0.02)), [0, 0, -0.01], 0.2))
    bodies += [thing(f"ball{k}", ball(), [0.05 * k - 0.07, 0.05, 0.1]) for k in range(4)]
    return PlatformScene(tuple(bodies), lighting(0.5, lamp(0.3, 0.2, 1)))


def poses(count: int) -> Iterator[tuple[tuple[float, ...], FloatArray, FloatArray]]:
    rng = np.random.default_rng(5)
    for k, rotation in enumerate(random_rotations(rng, count)):
        yield SIZES[k % 2], rotation, rng.uniform([-0.1, -0.1, 0.03], [0.1, 0.1, 0.12])


def project(camera: Camera, points: Array) -> FloatArray:
    rotation, _ = cv2.Rodrigues(camera.camera_from_world[:3, :3])
    translation = camera.camera_from_world[:3, 3]
    pixels, _ = cv2.projectPoints(points, rotation, translation, camera.matrix, camera.distortion)
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def outline(camera: Camera, points: Array) -> FloatArray:
    """The distorted polygon around a convex body: straight edges in space, projected in many short steps."""
    in_camera = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    flat = (in_camera[:, :2] / in_camera[:, 2:]).astype(np.float32)
    ring = points[cv2.convexHull(flat, returnPoints=False).ravel()]
    steps = np.linspace(0, 1, 50, endpoint=False)[:, None]
    edges = zip(ring, np.roll(ring, -1, axis=0), strict=True)
    return project(camera, np.concatenate([a + (b - a) * steps for a, b in edges]))


def centroid(polygon: Array) -> FloatArray:
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1]
    return np.asarray(((polygon + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum()))


def test_objects_lie_where_opencv_projects_them() -> None:
    shifts = []
    for size, rotation, position in poses(24):
        body = cuboid(size, rotation, position)
        scene = PlatformScene((body,), lighting())
        for camera in default_cameras():
            lens = Lens(camera, 2)
            layers = RENDERER.render(scene, lens.view, shadows=False)
            polygon = outline(camera, corners(np.array(size)) @ rotation.T + position)
            share = lens.to_camera(layers.labels > 0, "mean")
            rows, columns = np.nonzero(lens.to_camera(layers.labels, "label"))
            ring = polygon.astype(np.float32)
            for point in zip(columns.tolist(), rows.tolist(), strict=True):
                assert cv2.pointPolygonTest(ring, point, measureDist=True) > -1
            y, x = np.indices(share.shape)
            center = np.array([(share * x).sum(), (share * y).sum()]) / share.sum()
            shifts.append(center - centroid(polygon))
    assert (np.abs(np.mean(shifts, axis=0)) < 0.01).all()
    assert (np.abs(shifts) < 0.15).all()


def test_faces_bear_their_labels_and_colors() -> None:
    seen = set()
    for size, rotation, position in poses(12):
        scene = PlatformScene((cuboid(size, rotation, position),), lighting())
        for camera in default_cameras():
            lens = Lens(camera, 2)
            layers = RENDERER.render(scene, lens.view, shadows=False)
            labels, color = lens.to_camera(layers.labels, "label"), lens.to_camera(layers.color, "mean")
            centers = FACE_NORMALS * np.array(size) / 2 @ rotation.T + position
            for face, center in enumerate(centers):
                towards = camera.position - center
                if rotation @ FACE_NORMALS[face] @ towards < 0.35 * np.linalg.norm(towards):
                    continue
                column, row = np.rint(project(camera, center[None])[0]).astype(int)
                assert labels[row, column] == LABELS[face]
                cosines = COLORS @ color[row, column] / np.linalg.norm(COLORS, axis=1)
                assert np.argmax(cosines) == face
                seen.add(face)
    assert seen == set(range(6))


def everything(layers: Layers) -> bytes:
    return layers.color.tobytes() + layers.labels.tobytes() + layers.alone.tobytes()


def test_same_scene_gives_same_bits() -> None:
    view = Lens(default_cameras()[0], 2).view
    first = everything(RENDERER.render(crowded(np.eye(3)), view))
    rotation = random_rotations(np.random.default_rng(1), 1)[0]
    other = everything(RENDERER.render(crowded(rotation), Lens(default_cameras()[1], 1).view))
    assert everything(RENDERER.render(crowded(np.eye(3)), view)) == first != other


def test_what_stands_in_front_does_not_change_the_object_alone() -> None:
    scene, view = crowded(np.eye(3)), Lens(default_cameras()[0], 1).view
    layers = RENDERER.render(scene, view)
    alone = RENDERER.render(PlatformScene(scene.bodies[:1], scene.lighting), view)
    assert np.array_equal(layers.alone, alone.labels)
    assert np.array_equal(alone.alone, alone.labels)
    hidden = layers.labels != layers.alone
    assert 0 < hidden.sum() < 0.9 * (layers.alone > 0).sum()
    assert not layers.labels[hidden].any()


def test_shadows_only_take_light_away() -> None:
    scene, view = crowded(np.eye(3)), Lens(default_cameras()[0], 1).view
    dark, bright = (RENDERER.render(scene, view, shadows=shadows) for shadows in (True, False))
    assert np.array_equal(dark.labels, bright.labels)
    assert (dark.color <= bright.color + 1e-6).all()
    assert (dark.color < 0.8 * bright.color).any(axis=-1).mean() > 0.02


def test_light_is_linear() -> None:
    lens = Lens(default_cameras()[0], 1)
    colors = []
    for ambient, strength in ((0.2, 0.0), (0.0, 0.7), (0.4, 2.1)):
        light = lighting(ambient, lamp(0.3, 0.2, 1, strength))
        scene = PlatformScene(crowded(np.eye(3)).bodies, light)
        colors.append(RENDERER.render(scene, lens.view).color)
    np.testing.assert_allclose(colors[2], 2 * colors[0] + 3 * colors[1], rtol=1e-5, atol=1e-6)


def test_lambert_holds_on_a_level_table() -> None:
    scene = PlatformScene(
        (thing("table", box((0.5, 0.5, 0.02)), [0, 0, -0.01], 0.2),), lighting(0.5, lamp(3, 0, 4, 0.5))
    )
    camera = default_cameras()[0]
    color = Lens(camera, 1).to_camera(
        RENDERER.render(scene, Lens(camera, 1).view, shadows=False).color, "mean"
    )
    column, row = np.rint(project(camera, np.zeros((1, 3)))[0]).astype(int)
    np.testing.assert_allclose(color[row, column], 0.2 * (0.5 + 0.5 * 0.8), rtol=1e-3)


def test_empty_scene_is_black() -> None:
    layers = RENDERER.render(PlatformScene((), lighting()), Lens(default_cameras()[0], 1).view)
    assert not layers.color.any()
    assert not layers.labels.any()
    assert not layers.alone.any()


def resident_megabytes() -> float:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="system: memory is read from /proc")
def test_memory_stays_flat() -> None:
    camera = default_cameras(64)[0]
    view = Lens(camera, 1).view
    rotations = random_rotations(np.random.default_rng(2), 220)
    for k, rotation in enumerate(rotations):
        if k == 20:
            before = resident_megabytes()
        RENDERER.render(crowded(rotation), view, shadows=k % 10 == 0)
    assert resident_megabytes() - before < 15


def test_pyrender_sees_the_same_labels_and_depths() -> None:
    scene = crowded(random_rotations(np.random.default_rng(3), 1)[0])
    for camera in default_cameras():
        view = Lens(camera, 2).view
        own = RENDERER.render(scene, view, shadows=False)
        try:
            labels, depth = labels_and_depth(scene, view)
        except RendererError as error:
            lack("platform", str(error))
        assert (own.labels != labels).mean() < 2e-4
        assert ((own.nearness > 0) == (depth > 0)).mean() > 1 - 2e-4
        both = (own.nearness > 0) & (depth > 0)
        assert np.quantile(np.abs(1 / own.nearness[both] - depth[both]), 0.999) < 1e-4


def test_a_process_keeps_one_renderer_and_knows_no_other() -> None:
    assert choose_renderer("auto") is choose_renderer("raster") is RENDERER
    with pytest.raises(RendererError, match=r"'cycles'.*auto or raster"):
        choose_renderer("cycles")


@pytest.mark.parametrize("supersampling", [1, 2, 3])
def test_lens_keeps_flat_layers_and_places(supersampling: int) -> None:
    camera = default_cameras()[0]
    lens = Lens(camera, supersampling)
    view = lens.view
    assert np.allclose(lens.to_camera(np.full((view.height, view.width, 3), 0.3, np.float32), "mean"), 0.3)
    # A layer that holds its own rays: coordinates come back as OpenCV distorts them.
    x, y = np.meshgrid(np.arange(view.width), np.arange(view.height))
    rays = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones(x.shape)], axis=-1)
    back = lens.to_camera(rays, "mean").astype(float).reshape(-1, 3)
    nothing = np.zeros(3)
    pixels, _ = cv2.projectPoints(back, nothing, nothing, camera.matrix, camera.distortion)
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    assert np.abs(pixels.reshape(grid.shape) - grid).max() < 0.03
