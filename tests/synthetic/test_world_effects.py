"""Effects that change scenes: each by itself, none of them the truth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.needs import lack
from tests.helpers.synthetic_needs import skip_without_platform

SCENE_EFFECTS = ("chamfers", "surface", "table", "fittings", "reflections")


@pytest.fixture(autouse=True)
def platform():
    skip_without_platform()


def make(*effects, name="cube_v2", **more):
    from synthetic.frames import frames

    options = {"quality": "fast", "empty": 0.0, "effects": effects, **more}
    return list(frames(name, 2, 77, **options))


def fingerprint(body):
    return (
        body.name,
        body.mesh.key,
        body.world_from_body.tobytes(),
        body.colors.tobytes(),
        np.asarray(body.labels).tobytes(),
        np.asarray(body.coats).tobytes(),
        body.texture,
        np.asarray(body.mesh.vertices).tobytes(),
    )


def test_without_effects_a_scene_is_the_very_one_that_was_made():
    from synthetic.effects import Effects
    from synthetic.world.effects import with_effects

    scene = make()[0].scene
    assert with_effects(scene, Effects.none(), 77, 0) is scene
    assert with_effects(scene, Effects.only("focus", "compression"), 77, 0) is scene


@pytest.mark.parametrize("name", ["cube_v2", "dice"])
def test_effects_change_neither_truth_nor_light_nor_robot(name):
    tidy, worn = make(name=name), make(*SCENE_EFFECTS, name=name)
    cameras = ("camera60", "camera180", "camera300")
    for one, other in zip(tidy, worn, strict=True):
        truths = [frame.truth(cameras) for frame in (one, other)]
        for truth in truths:
            del truth["cameras"]  # how many pixels are seen: fittings cover some
        assert truths[0] == truths[1]
        for lamp, same in zip(one.scene.lighting.lamps, other.scene.lighting.lamps, strict=True):
            np.testing.assert_array_equal(lamp.direction, same.direction)
            np.testing.assert_array_equal(lamp.color, same.color)
        assert any(not np.array_equal(a, b) for a, b in zip(one.images, other.images, strict=True))


def test_an_effect_leaves_the_draws_of_the_others_alone():
    together = {fingerprint(body) for body in make(*SCENE_EFFECTS)[0].scene.bodies}
    tidy = {fingerprint(body) for body in make()[0].scene.bodies}
    for name in ("table", "fittings"):
        own = {fingerprint(body) for body in make(name)[0].scene.bodies} - tidy
        assert own
        assert own <= together
    keys = {name: make(name)[0].scene.bodies[-1].mesh.key for name in ("chamfers", "surface")}
    whole = next(b for b in make("chamfers", "surface")[0].scene.bodies if b.name == "cube_v2").mesh.key
    assert whole.startswith(keys["chamfers"])
    assert whole.endswith(keys["surface"].split("_print_")[1])


def test_a_film_keeps_its_wear():
    first, second = make("table", "chamfers", sequence=True, kind="push", length=2)
    for one, other in zip(first.scene.bodies, second.scene.bodies, strict=True):
        assert (one.name, one.mesh.key, one.colors.tobytes()) == (
            other.name,
            other.mesh.key,
            other.colors.tobytes(),
        )


def test_rims_take_pixels_from_the_silhouette_and_give_none():
    for one, other in zip(make(), make("chamfers"), strict=True):
        for before, after in zip(one.labels, other.labels, strict=True):
            assert not ((after > 0) & (before == 0)).any()
            assert (after > 0).sum() >= 0.95 * (before > 0).sum()


def test_a_coat_only_adds_light():
    import dataclasses

    from synthetic.camera.lens import Lens
    from synthetic.camera.rigs import default_cameras
    from synthetic.render.choose import choose_renderer

    scene = make()[0].scene
    bodies = [
        dataclasses.replace(body, coats=np.tile([1.0, 0.2], (len(body.colors), 1))) for body in scene.bodies
    ]
    view = Lens(default_cameras()[0], 1).view
    plain, coated = (
        choose_renderer().render(s, view).color
        for s in (scene, dataclasses.replace(scene, bodies=tuple(bodies)))
    )
    assert (coated >= plain).all()
    assert (coated > plain).any(axis=-1).mean() > 0.5


def test_pyrender_sees_the_labels_of_scenes_with_effects():
    from synthetic.camera.lens import Lens
    from synthetic.camera.rigs import default_cameras
    from synthetic.errors import RendererError
    from synthetic.render.check import labels_and_depth
    from synthetic.render.choose import choose_renderer

    scene, view = make(*SCENE_EFFECTS)[0].scene, Lens(default_cameras()[0], 1).view
    try:
        labels, _ = labels_and_depth(scene, view)
    except RendererError as error:
        lack("platform", str(error))
    assert (choose_renderer().render(scene, view).labels != labels).mean() < 5e-4
