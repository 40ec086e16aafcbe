import functools
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.pyrender_labels import labels_and_depth
from tests.helpers.synthetic_needs import missing, skip_without_platform

if missing():
    skip_without_platform()

from synthetic.camera.lens import Lens
from synthetic.camera.rigs import default_cameras
from synthetic.frames import frames
from synthetic.render.renderer import render
from synthetic.world.effects import MOVING, SIZE_M, SPEED, still_at, with_effects

SCENE_EFFECTS = ("sizes", "chamfers", "surface", "table", "reflections", "contact", "clutter")


@functools.cache
def make(*effects, name="cube_v2", seed=77, **more):
    return list(frames(name, 2, seed, quality="fast", empty=0.0, effects=effects, **more))


def worn(*effects):
    """The scene with effects, of which no picture is drawn."""
    return with_effects(make()[0].scene, effects, 77, 0)


def fingerprint(body):
    arrays = (body.world_from_body, body.colors, body.labels, body.coats, body.mesh.vertices)
    return (body.name, body.mesh.key, body.texture, *(np.asarray(array).tobytes() for array in arrays))


def test_without_effects_a_scene_is_the_very_one_that_was_made_and_rims_only_take_pixels_from_it():
    scene = make()[0].scene
    assert with_effects(scene, (), 77, 0) is scene
    assert with_effects(scene, ("focus", "compression"), 77, 0) is scene
    for one, other in zip(make(), make("chamfers"), strict=True):
        for before, after in zip(one.labels, other.labels, strict=True):
            assert not ((after > 0) & (before == 0)).any()
            assert (after > 0).sum() >= 0.95 * (before > 0).sum()


@pytest.mark.parametrize("name", ["cube_v2", "dice"])
def test_effects_change_neither_truth_nor_light_nor_robot(name):
    tidy, changed = make(name=name), make(*SCENE_EFFECTS, name=name)
    for one, other in zip(tidy, changed, strict=True):
        truths = [frame.truth() for frame in (one, other)]
        for truth in truths:
            del truth["cameras"]  # how many pixels are seen: rims take some
        assert truths[0] == truths[1]
        for lamp, same in zip(one.scene.lighting.lamps, other.scene.lighting.lamps, strict=True):
            np.testing.assert_array_equal(lamp.direction, same.direction)
            np.testing.assert_array_equal(lamp.color, same.color)
        assert any(not np.array_equal(a, b) for a, b in zip(one.images, other.images, strict=True))


def test_an_effect_leaves_the_draws_of_the_others_alone():
    together = {fingerprint(body) for body in worn(*SCENE_EFFECTS).bodies}
    assert together == {fingerprint(body) for body in make(*SCENE_EFFECTS)[0].scene.bodies}
    tidy = {fingerprint(body) for body in make()[0].scene.bodies}
    for name in ("table", "clutter"):
        own = {fingerprint(body) for body in worn(name).bodies} - tidy
        assert own
        assert own <= together
    keys = {name: worn(name).bodies[-1].mesh.key for name in ("chamfers", "surface")}
    whole = next(b for b in worn("chamfers", "surface").bodies if b.name == "cube_v2").mesh.key
    assert whole.startswith(keys["chamfers"])
    assert whole.endswith(keys["surface"].split("_print_")[1])


def test_a_film_keeps_its_wear_and_its_clutter_while_the_object_moves():
    one, other = make("table", "chamfers", "clutter", sequence=True, length=2, rate=1.0, kind="mixed")
    assert not np.array_equal(one.objects[0].position, other.objects[0].position)
    for first, second in zip(one.scene.bodies, other.scene.bodies, strict=True):
        assert (first.name, first.mesh.key) == (second.name, second.mesh.key)
        assert np.array_equal(first.colors, second.colors)
        assert not first.name.startswith("clutter") or fingerprint(first) == fingerprint(second)
    assert any(body.name.startswith("clutter") for body in one.scene.bodies)


def test_a_coat_only_adds_light_and_pyrender_sees_the_labels_of_scenes_with_effects():
    scene = make()[0].scene
    coats = [np.tile([1.0, 0.2], (len(body.colors), 1)) for body in scene.bodies]
    bodies = [replace(body, coats=own) for body, own in zip(scene.bodies, coats, strict=True)]
    scenes = (scene, replace(scene, bodies=tuple(bodies)))
    view = Lens(default_cameras()[0], 1).view
    plain, coated = (render(one, view).color for one in scenes)
    assert (coated >= plain).all()
    assert (coated > plain).any(axis=-1).mean() > 0.5
    scene = make(*SCENE_EFFECTS)[0].scene
    labels, _ = labels_and_depth(scene, view)
    assert (render(scene, view).labels != labels).mean() < 5e-4


def test_sizes_are_off_by_little_about_the_same_centre():
    changes = []
    for one, other in zip(make(), make("sizes"), strict=True):
        tidy, own = (frame.scene.bodies[-1].mesh.vertices for frame in (one, other))
        np.testing.assert_allclose(own.min(axis=0), -own.max(axis=0), atol=1e-15)
        changes.append(2 * (own.max(axis=0) - tidy.max(axis=0)))
        assert np.array_equal(one.objects[0].position, other.objects[0].position)
    assert len(np.unique(np.round(changes, 9))) == 6
    assert 0 < np.abs(changes).max() <= SIZE_M


@pytest.mark.parametrize("name", ["cube_v2", "cuboid_2x2x8_v2"])
def test_clutter_is_seen_and_hides_next_to_nothing(name):
    seen, hidden, shown = [], 0, 0
    for seed in (77, 2):
        for one, other in zip(make(name=name, seed=seed), make("clutter", name=name, seed=seed), strict=True):
            for labels, same in zip(one.labels, other.labels, strict=True):
                assert np.array_equal(labels[same > 0], same[same > 0])
                hidden, shown = hidden + np.sum(labels != same), shown + np.sum(labels > 0)
            for image, changed in zip(one.images, other.images, strict=True):
                seen.append(np.abs(image.astype(int) - changed).max() > 60)
    assert np.mean(seen) > 0.5
    assert hidden < 0.01 * shown


def test_what_moves_while_the_shutter_is_open_is_where_the_truth_says_in_the_middle_of_it():
    effects, fastest, moving = ["motion_blur"], 0.0, 0
    scene = make()[0].scene
    for number in range(40):
        at = still_at(scene, 1.0, effects, 5, number)
        assert at(1.0) is scene
        before, after = (at(1.0 + way * 0.005).objects[0] for way in (-1, 1))
        moving += before is not scene.objects[0]
        middle = (before.position + after.position) / 2
        np.testing.assert_allclose(middle, scene.objects[0].position, atol=1e-5)
        fastest = max(fastest, np.linalg.norm(after.position - before.position) / 0.01)
        body = next(body for body in at(1.005).bodies if body.faces)
        np.testing.assert_allclose(body.world_from_body[:3, 3], after.position, atol=1e-12)
    assert 0.8 * SPEED < fastest <= SPEED
    assert moving == pytest.approx(40 * MOVING, abs=8)
