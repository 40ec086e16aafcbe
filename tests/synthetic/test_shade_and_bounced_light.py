import dataclasses

import numpy as np
import pytest

pytest.importorskip("trimesh", reason="platform: no module trimesh")

from synthetic.camera.lens import Lens
from synthetic.camera.rigs import default_cameras
from synthetic.render.hits import empty_hits
from synthetic.render.renderer import render
from synthetic.render.shading import add_bounced
from synthetic.render.shadows import add_contact, hidden
from synthetic.render.surfaces import surfaces_of
from synthetic.scene import Body, Lamp, Lighting, Patches, PlatformScene
from synthetic.world.effects import CONTACT, CONTACT_M, with_effects
from synthetic.world.meshes import box, disc

SIZE = np.array([0.06, 0.06, 0.06])
VIEW = Lens(default_cameras()[0], 1).view
WIDTH = 0.003


def scene(strength=0.8, clearance=0.0, width=WIDTH):
    pose = np.eye(4)
    pose[2, 3] = SIZE[2] / 2 + clearance
    table = Body("table", disc(0.2), np.eye(4), np.full((1, 3), 0.1), np.zeros(1, np.uint8))
    labels = np.arange(1, 7, dtype=np.uint8)
    cube = Body("cube", box(SIZE), pose, np.full((6, 3), 0.5), labels, faces=True)
    light = Lighting(np.full(3, 0.6), (Lamp(np.array([0.0, 0.0, 1.0]), np.full(3, 0.4)),))
    return PlatformScene((table, cube), light, contact=(strength, width))


def picture(one):
    return render(one, VIEW).color


def left(points, body, one):
    """Share of the sky (N,) that is left at points (N, 3) of a body, of one that nothing hides."""
    hits, reach = empty_hits(1, len(points)), np.ones((1, len(points), 2), np.float32)
    hits.body[:], hits.points[0], hits.normals[0] = body, points, (1.0, 0.0, 0.0)
    add_contact(reach, hits, one)
    assert (reach[..., 1] == 1).all()  # a lamp's light stays
    return reach[0, :, 0]


def test_shade_is_deepest_at_the_contact_and_gone_far_from_it():
    share = [hidden(distance, WIDTH) for distance in np.linspace(0.0, 0.06, 200)]
    assert share[0] == 1
    assert (np.diff(share) < 0).all()
    assert 0 < share[-1] < 2e-3
    # Of the half of the view that faces the ground, a strip from d to d + w seen from the height d.
    assert hidden(WIDTH, WIDTH) == pytest.approx(1 - np.sqrt(0.5))
    # Face and table darken alike towards their common line.
    distance = np.linspace(0.0, 0.02, 50)
    face = np.stack([np.full(50, 0.03), np.zeros(50), distance], axis=1)
    table = np.stack([0.03 + distance, np.zeros(50), np.zeros(50)], axis=1)
    for strength in (0.3, 1.0):
        expected = [1 - strength * hidden(one, WIDTH) for one in distance]
        np.testing.assert_allclose(left(face, 1, scene(strength)), expected, atol=1e-6)
        np.testing.assert_allclose(left(table, 0, scene(strength)), expected, atol=1e-5)


def test_none_is_the_old_picture_and_a_lifted_box_has_none():
    plain = picture(scene(0.0))
    assert (picture(scene(0.8)) < plain).any()
    assert (picture(scene(0.8)) <= plain).all()
    # Surely lifted, its picture is the one that it would have without; slightly, it has less of the shade.
    assert np.array_equal(picture(scene(0.8, WIDTH)), picture(scene(0.0, WIDTH)))
    foot = np.array([[0.03, 0.0, 0.0]])
    shade = [1 - left(foot, 1, scene(0.8, share * WIDTH))[0] for share in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(shade, [0.8, 0.4, 0.0], atol=1e-6)
    without = dataclasses.replace(scene(0.8), bodies=scene().bodies[:1])
    assert np.array_equal(picture(without), picture(dataclasses.replace(without, contact=(0.0, 0.0))))


def test_colours_end_the_farther_above_the_contour_the_stronger_the_shade():
    ends, near = [], Lens(default_cameras()[0], 4).view
    for strength in (0.0, 0.6, 0.8, 1.0):
        light = render(scene(strength), near)
        sides = light.color[(light.labels > 0) & (light.labels < 5), 0]
        ends.append(int((sides > 0.5 * np.median(sides)).sum()))
    assert ends[0] >= ends[1] > ends[2] > ends[3]


def test_the_same_seed_draws_the_same_shade_and_all_strengths_occur():
    drawn = [with_effects(scene(), ["contact"], 5, number).contact for number in range(200)]
    assert drawn[7] == with_effects(scene(), ["contact"], 5, 7).contact
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    for k, (least, most) in enumerate((CONTACT, CONTACT_M)):
        assert least <= low[k] < least + 0.1 * (most - least)
        assert most - 0.1 * (most - least) < high[k] <= most


LIGHT = np.array([0.2, 0.5, 0.9])
ALBEDO = np.array([0.5, 0.25, 0.1])


def patch(place, normal=(0.0, 0.0, -1.0), area=1e-6, owner="lid"):
    one = [np.array(value, dtype=float)[None] for value in (place, normal)]
    return Patches(*one, np.array([area]), LIGHT[None], np.array([owner]))


def given(patches):
    """What a point of the floor at the origin sends on, facing up."""
    hits = empty_hits(1, 1)
    hits.body[0, 0], hits.row[0, 0] = 0, 0
    hits.points[0, 0], hits.normals[0, 0] = 0.0, (0.0, 0.0, 1.0)
    color, labels = np.zeros((1, 1, 3), np.float32), np.zeros(1, np.uint8)
    discs = (Body(name, disc(0.1), np.eye(4), ALBEDO[None], labels) for name in ("floor", "lid"))
    whole = PlatformScene(tuple(discs), Lighting(np.zeros(3)))
    add_bounced(color, whole, patches, hits, surfaces_of(whole))
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


def test_patches_add_up_and_what_lies_behind_or_turns_away_or_is_the_same_body_gives_nothing():
    above = (0.0, 0.0, 0.03)
    assert given(patch(above)).all()
    for nothing in (patch((0.0, 0.0, -0.03)), patch(above, (0.0, 0.0, 1.0)), patch(above, owner="floor")):
        assert not given(nothing).any()
    near = patch((0.0, 0.0, 0.001), area=0.01)
    assert (given(near) <= ALBEDO * LIGHT).all()
    two = Patches.joined([patch((0.01, 0.0, 0.03)), patch((-0.02, 0.0, 0.03))])
    parts = [given(two.chosen(np.array(which))) for which in ([True, False], [False, True])]
    np.testing.assert_allclose(given(two), sum(parts), rtol=1e-5)
    double = two._replace(light=2 * two.light)
    np.testing.assert_allclose(given(double), 2 * given(two), rtol=1e-5)
