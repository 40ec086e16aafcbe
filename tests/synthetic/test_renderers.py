import numpy as np
import pytest

from synthetic.camera.lens import Lens
from synthetic.camera.rigs import default_cameras
from synthetic.render.renderer import render
from synthetic.scene import Body, Lamp, Lighting, Mesh, PlatformScene
from tests.helpers import opencv_pixels, random_rotations
from tests.helpers.pyrender_labels import labels_and_depth
from tracker.conventions import Array
from tracker.geometry import so3
from tracker.geometry.cuboid import FACE_CORNERS, corners

LABELS = np.array([1, 6, 2, 5, 3, 4], np.uint8)  # +x … -z, none twice
COLORS = np.array([[1, 1, 10], [1, 9, 9], [2, 8, 2], [7, 2, 7], [9, 2, 1], [8, 7, 1]]) / 20
WHITE = np.ones(3)
CAMERA = default_cameras()[0]
LENS = Lens(CAMERA, 1)


def box(size: tuple[float, ...]) -> Mesh:
    triangles = np.concatenate([FACE_CORNERS[:, [0, 1, 2]], FACE_CORNERS[:, [0, 2, 3]]])
    return Mesh(f"box {size}", corners(np.array(size)), triangles, np.tile(np.arange(6), 2))


def ball(radius: float = 0.02) -> Mesh:
    trimesh = pytest.importorskip("trimesh", reason="platform: no module trimesh")
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh("ball", sphere.vertices, sphere.faces, np.zeros(len(sphere.faces), int))


def lighting(ambient: float = 0.5, *lamps: Lamp) -> Lighting:
    return Lighting(ambient * WHITE, lamps)


def lamp(x: float, y: float, z: float, strength: float = 0.5) -> Lamp:
    return Lamp(np.array([x, y, z]) / np.linalg.norm([x, y, z]), strength * WHITE)


def thing(name: str, mesh: Mesh, position: Array, reflectance: float = 0.5) -> Body:
    groups, pose = int(mesh.groups.max()) + 1, so3.transform(np.eye(3), position)
    return Body(name, mesh, pose, np.full((groups, 3), reflectance), np.zeros(groups, np.uint8))


TABLE = thing("table", box((0.5, 0.5, 0.02)), [0, 0, -0.01], 0.2)


def crowded(rotation: Array) -> PlatformScene:
    pose = so3.transform(rotation, [0.02, -0.01, 0.06])
    cube = Body("object", box((0.065, 0.065, 0.065)), pose, COLORS, LABELS, gloss=0.1, texture=0.1)
    balls = (thing(f"ball{k}", ball(), [0.05 * k - 0.07, 0.05, 0.1]) for k in range(4))
    return PlatformScene((cube, TABLE, *balls), lighting(0.5, lamp(0.3, 0.2, 1)))


def test_light_is_linear_and_shadows_only_take_it_away() -> None:
    scene = crowded(np.eye(3))
    dark, bright = (render(scene, LENS.view, shadows=shadows) for shadows in (True, False))
    assert np.array_equal(dark.labels, bright.labels)
    assert (dark.color <= bright.color + 1e-6).all()
    assert (dark.color < 0.8 * bright.color).any(axis=-1).mean() > 0.02
    colors = []
    for ambient, strength in ((0.2, 0.0), (0.0, 0.7), (0.4, 2.1)):
        light = lighting(ambient, lamp(0.3, 0.2, 1, strength))
        scene = PlatformScene(crowded(np.eye(3)).bodies, light)
        colors.append(render(scene, LENS.view).color)
    np.testing.assert_allclose(colors[2], 2 * colors[0] + 3 * colors[1], rtol=1e-5, atol=1e-6)


def test_lambert_holds_on_a_level_table_and_an_empty_scene_is_black() -> None:
    scene = PlatformScene((TABLE,), lighting(0.5, lamp(3, 0, 4, 0.5)))
    color = LENS.to_camera(render(scene, LENS.view, shadows=False).color, "mean")
    column, row = np.rint(opencv_pixels(CAMERA, np.zeros((1, 3)))[0]).astype(int)
    np.testing.assert_allclose(color[row, column], 0.2 * (0.5 + 0.5 * 0.8), rtol=1e-3)
    layers = render(PlatformScene((), lighting()), LENS.view)
    assert not layers.color.any()
    assert not layers.labels.any()
    assert not layers.alone.any()


def test_pyrender_sees_the_same_labels_and_depths() -> None:
    scene = crowded(random_rotations(np.random.default_rng(3), 1)[0])
    for camera in default_cameras():
        view = Lens(camera, 2).view
        own = render(scene, view, shadows=False)
        labels, depth = labels_and_depth(scene, view)
        assert (own.labels != labels).mean() < 2e-4
        assert ((own.nearness > 0) == (depth > 0)).mean() > 1 - 2e-4
        both = (own.nearness > 0) & (depth > 0)
        assert np.quantile(np.abs(1 / own.nearness[both] - depth[both]), 0.999) < 1e-4
