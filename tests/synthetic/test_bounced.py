"""Light that patches give: against closed forms."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("trimesh", reason="platform: no module trimesh")

from synthetic.render.hits import empty_hits
from synthetic.render.shading import add_bounced
from synthetic.render.surfaces import SurfaceStore
from synthetic.scene import Body, Lighting, Patches, PlatformScene
from synthetic.world.meshes import disc

LIGHT = np.array([0.2, 0.5, 0.9])
ALBEDO = np.array([0.5, 0.25, 0.1])


def scene():
    labels = np.zeros(1, dtype=np.uint8)
    bodies = tuple(Body(name, disc(name, 0.1), np.eye(4), ALBEDO[None], labels) for name in ("floor", "lid"))
    return PlatformScene(bodies, Lighting(np.zeros(3)))


def patch(place, normal=(0.0, 0.0, -1.0), area=1e-6, owner="lid"):
    one = [np.array(value, dtype=float)[None] for value in (place, normal)]
    return Patches(*one, np.array([area]), LIGHT[None], (owner,))


def given(patches):
    """What a point of the floor at the origin sends on, facing up."""
    hits = empty_hits(1, 1)
    hits.body[0, 0], hits.row[0, 0] = 0, 0
    hits.points[0, 0], hits.normals[0, 0] = 0.0, (0.0, 0.0, 1.0)
    color = np.zeros((1, 1, 3), np.float32)
    whole = scene()
    add_bounced(color, whole, patches, hits, SurfaceStore().of_scene(whole))
    return color[0, 0]


def test_a_far_patch_gives_by_its_solid_angle_and_both_cosines():
    distance, area = 0.05, 1e-6
    for angle in (0.0, 0.4, 1.0):
        place = distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
        expected = ALBEDO * LIGHT * np.cos(angle) ** 2 * area / (np.pi * distance**2)
        np.testing.assert_allclose(given(patch(place, area=area)), expected, rtol=1e-3)
        # A round thing of that section faces everything.
        round_one = given(patch(place, (0.0, 0.0, 0.0), area))
        np.testing.assert_allclose(round_one, expected / np.cos(angle), rtol=1e-3)


def test_what_lies_behind_or_turns_away_or_is_the_same_body_gives_nothing():
    for nothing in (
        patch((0.0, 0.0, -0.03)),
        patch((0.0, 0.0, 0.03), normal=(0.0, 0.0, 1.0)),
        patch((0.0, 0.0, 0.03), owner="floor"),
    ):
        assert not given(nothing).any()


def test_patches_add_up_and_give_no_more_than_they_have():
    near = patch((0.0, 0.0, 0.001), area=0.01)
    assert (given(near) <= ALBEDO * LIGHT).all()
    two = Patches.joined([patch((0.01, 0.0, 0.03)), patch((-0.02, 0.0, 0.03))])
    parts = [given(two.chosen(np.array(which))) for which in ([True, False], [False, True])]
    np.testing.assert_allclose(given(two), sum(parts), rtol=1e-5)
    double = dataclasses.replace(two, light=2 * two.light)
    np.testing.assert_allclose(given(double), 2 * given(two), rtol=1e-5)
