import functools

import numpy as np
import pytest

from tests.helpers.synthetic_needs import missing, skip_without_platform

if missing():
    skip_without_platform()

from synthetic.camera.rigs import standard_rig
from synthetic.frames import frames
from synthetic.world.look_alikes import KINDS, LARGER, LONGER, SHORTER, SMALLER, look_alike
from synthetic.world.look_alikes import turned_arrangements as turned
from synthetic.world.scenes import random_scene
from tests.helpers.stills import platform
from tracker import CameraRig

RIG = CameraRig(standard_rig().cameras[2:])
OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
REARRANGED = ("permuted", "plain", "layers", "other_object", "mirrored", "pairs")


def make(look_alike, name="cube_v2", seed=31, count=1, **more):
    options = {"rig": RIG, "quality": "fast", "empty": 0.0, "look_alike": look_alike, **more}
    return list(frames(name, count, seed, **options))


def marked(scene):
    """The bodies that show the object, or what stands for it."""
    return [body for body in scene.bodies if body.labels.any()]


def bare_scenes(name, count):
    """Scenes without fingers, each with the generator that drew it."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        yield random_scene(platform(name), rng, near=None), rng


def ratios(scene, kind, rng):
    """Sizes of a look-alike over those of the object that a scene shows."""
    ((other,), (usual,)) = (marked(one) for one in (look_alike(scene, kind, rng), scene))
    sizes = [np.ptp(body.mesh.vertices, axis=0) for body in (other, usual)]
    return np.round(sizes[0] / sizes[1], 9)


@functools.cache
def shown(kind, name):
    """A frame of a kind; of None, the tidy one."""
    return make(kind, name)[0]


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_is_seen_has_no_truth_and_leaves_all_else_alone(kind, name):
    frame, usual = shown(kind, name), shown(None, name)
    assert frame.objects == ()
    assert frame.truth()["object"] is None
    assert frame.scene.about["look_alike"] == kind
    assert frame.visible_px[0] > 60
    assert (frame.visible_fraction <= 1).all()
    assert not marked(frame.scene.emptied())
    others = {body.name: body for body in usual.scene.bodies if not body.labels.any()}
    for body in frame.scene.bodies:
        if not body.labels.any():
            assert np.array_equal(body.world_from_body, others.pop(body.name).world_from_body)
    assert not others


@pytest.mark.parametrize("name", OBJECTS)
def test_faces_that_are_seen_have_the_colors_of_their_labels(name):
    (usual,) = (body for body in shown(None, name).scene.bodies if body.faces)
    paints = {int(label): color for label, color in zip(usual.labels, usual.colors, strict=True)}
    for kind in KINDS:
        frame = shown(kind, name)
        for body in marked(frame.scene):
            assert set(body.labels.tolist()) <= set(range(7))
            for label, color in zip(body.labels, body.colors, strict=True):
                if label and kind != "other_object":
                    np.testing.assert_array_equal(color, paints[int(label)])
        levels = [frame.images[0][frame.labels[0] == label] for label in paints]
        # Light differs by face and lamp, hue hardly.
        known = np.sqrt(np.stack(list(paints.values())))
        for number, level in enumerate(levels):
            if len(level) > 100 and kind != "other_object":
                cosines = known @ np.median(level, axis=0) / np.linalg.norm(known, axis=1)
                assert np.argmax(cosines) == number


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("kind", REARRANGED)
def test_no_other_arrangement_is_the_true_one_turned(kind, name):
    own = platform(name).model.face_labels
    true = turned(own)
    assert len(true) == 24
    for scene, rng in bare_scenes(name, 25):
        (body,) = marked(look_alike(scene, kind, rng))
        for first in range(0, len(body.labels) - 5, 6):
            assert tuple(body.labels[first : first + 6].tolist()) not in true
        if kind == "layers":
            slabs = np.vstack([own, body.labels.reshape(-1, 6)])
            assert 3 <= len(slabs) <= 4
            assert (np.diff(slabs, axis=0) != 0).all()
            assert (slabs[1:] != slabs[0]).all()


@pytest.mark.parametrize("name", OBJECTS)
def test_sizes_plates_photos_and_prisms_are_what_their_names_say(name):
    for scene, rng in bare_scenes(name, 10):
        (scale,) = np.unique(ratios(scene, "size", rng))
        assert SMALLER[0] <= scale <= SMALLER[1] or LARGER[0] <= scale <= LARGER[1]
        one, same, other = np.sort(ratios(scene, "stretched", rng))
        assert same == 1.0
        least, most = SHORTER if other == 1.0 else LONGER
        assert least <= one * other <= most
        assert 1.0 in (one, other)
    (cylinder,), (prism,) = (marked(shown(kind, name).scene) for kind in ("round", "prism"))
    assert 5 <= len(cylinder.labels) <= 8
    assert len(prism.labels) in (5, 8)
    for kind, most in (("plates", 3), ("photo", 1)):
        bodies = marked(shown(kind, name).scene)
        assert 1 <= len(bodies) <= most
        assert all(np.ptp(body.mesh.vertices, axis=0).min() < 0.005 for body in bodies)


@pytest.mark.parametrize("kind", KINDS)
def test_a_look_alike_is_the_same_thing_whatever_the_pose_of_the_object(kind):
    scenes = [scene for scene, _ in bare_scenes("cube_v2", 6)]
    things = [marked(look_alike(scene, kind, np.random.default_rng(1))) for scene in scenes]
    for others in things[1:]:
        for one, other in zip(things[0], others, strict=True):
            assert np.array_equal(one.labels, other.labels)
            np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)


def test_a_mirrored_object_and_one_in_pairs_keep_what_their_names_say():
    true = np.asarray(platform("cube_v2").model.face_labels)
    for scene, rng in bare_scenes("cube_v2", 10):
        (one,), (other,) = (marked(look_alike(scene, kind, rng)) for kind in ("mirrored", "pairs"))
        mirrored, pairs = one.labels, other.labels
        changed = np.flatnonzero(mirrored != true)
        assert len(changed) == 2
        assert changed[0] // 2 == changed[1] // 2
        assert set(mirrored.tolist()) == set(true.tolist())
        assert (pairs[::2] == pairs[1::2]).all()
        assert all(label in true[2 * axis : 2 * axis + 2] for axis, label in enumerate(pairs[::2]))


def test_look_alikes_repeat_to_the_bit_and_stay_through_a_film():
    (one,), (other,) = (make("layers", effects=("chamfers", "table")) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(one.images, other.images, strict=True))
    film = make("permuted", count=2, sequence=True, kind="push", length=2)
    assert len({body.labels.tobytes() for frame in film for body in marked(frame.scene)}) == 1
