import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import RIG
from tests.helpers.dice_scenes import EDGE, dice_at, painted
from tracker.geometry import so3
from tracker.geometry.lens import stack_lenses
from tracker.tasks.rearrange_dice import set_score
from tracker.tasks.rearrange_dice.evidence import DICE, UNKNOWN, evidence
from tracker.tasks.rearrange_dice.finder import STEPS, Search

DICE_POSES = dice_at([(0.0, 0.01), (-0.09, 0.05), (0.06, 0.08), (0.02, -0.09)], 0.37)


def views_of(masks) -> set_score.Views:
    return Search(RIG, masks, [None] * 3).views


CANVAS = set_score.Canvas(*(np.zeros((3, 270, 270), kind) for kind in (np.float32, np.int8, np.int16)))


def total(views: set_score.Views, dice: np.ndarray) -> float:
    return set_score.total(views, dice, 0.0, CANVAS)


@pytest.fixture(scope="module")
def views() -> set_score.Views:
    return views_of([painted(camera, DICE_POSES)[1] for camera in RIG])


def drawn(views: set_score.Views, dice: np.ndarray, c: int) -> tuple[np.ndarray, np.ndarray]:
    """Classes and owners in one view."""
    set_score.draw(views, c, dice, -1, np.array([0, 0, 270, 270]), CANVAS)
    return CANVAS.classes[c].copy(), CANVAS.owners[c].copy()


@pytest.mark.parametrize("c", range(3))
def test_dice_cover_the_pixels_that_opencv_paints_with_tops_where_rays_meet_the_upper_faces(views, c):
    classes, owners = drawn(views, DICE_POSES, c)
    truth = painted(RIG[c], DICE_POSES)[1] > 0
    assert np.count_nonzero((classes > 0) != truth) < 0.06 * np.count_nonzero(truth)
    rows, columns = np.nonzero(classes)
    rays = RIG[c].rays(np.stack([columns, rows], axis=1))
    shown = zip(rays, classes[rows, columns], DICE_POSES[owners[rows, columns]], strict=True)
    for ray, kind, die in list(shown)[::7]:
        sink = (RIG[c].position[2] - die[2] - EDGE) / -ray[2]
        place = so3.exp([0, 0, -die[3]]) @ (RIG[c].position + sink * ray - die[:3])
        reach = np.abs(place[:2]).max()
        if abs(reach - EDGE / 2) > 1e-5:
            assert (kind in (set_score.TOP, set_score.TOP_RIM)) == (reach < EDGE / 2)
        if kind in (set_score.TOP, set_score.TOP_RIM) and abs(reach - set_score.PIPS * EDGE / 2) > 1e-5:
            assert (kind == set_score.TOP) == (reach < set_score.PIPS * EDGE / 2)


def test_a_die_that_reaches_behind_a_low_camera_is_drawn():
    down, place = 0.506, np.array([0.0, 0.0, 0.0355])
    ahead = np.array([np.cos(down), 0.0, -np.sin(down)])
    axes = np.stack([[0.0, -1.0, 0.0], np.cross(ahead, [0.0, -1.0, 0.0]), ahead])
    camera = dataclasses.replace(RIG[0], camera_from_world=so3.transform(axes, -axes @ place))
    die, window = np.array([0.0026, 0.0152, 0.0, 0.0]), np.empty(4, np.int64)
    set_score.bounds(stack_lenses([camera]), 0, die, 0, window)
    columns, rows = (index.ravel() for index in np.meshgrid(range(270), range(270)))
    rays = camera.rays(np.stack([columns, rows], axis=1))
    top = place + rays * (die[2] + EDGE - place[2]) / rays[:, 2:]
    met = (np.abs(top[:, :2] - die[:2]) < EDGE / 2).all(axis=1) & (rays[:, 2] < 0)
    assert met.any()
    left, upper, right, lower = window
    assert (columns[met] >= left).all()
    assert (columns[met] < right).all()
    assert (rows[met] >= upper).all()
    assert (rows[met] < lower).all()


def test_the_nearer_of_two_dice_hides_the_other(views):
    camera = RIG[0]
    away = camera.position[:2] / np.linalg.norm(camera.position[:2])
    dice = dice_at([tuple(-0.013 * away), tuple(0.013 * away)])
    _, owners = drawn(views, dice, 0)
    alone = [np.count_nonzero(drawn(views, dice[k : k + 1], 0)[0]) for k in (0, 1)]
    seen = np.bincount(owners[owners >= 0], minlength=2)
    assert seen[1] == alone[1]
    assert seen[0] < alone[0]


poses = st.tuples(
    st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.sampled_from([0.0, 0.005, EDGE]), st.floats(-3, 3)
).map(np.array)


@given(poses, poses)
def test_dice_overlap_where_their_squares_do_in_either_order_and_not_above_each_other(first, second):
    reach = set_score.overlap(first, second)
    assert reach == pytest.approx(set_score.overlap(second, first), abs=1e-12)
    assert 0 <= reach <= 2 * EDGE
    lifted = second.copy()
    lifted[2] = first[2] + EDGE
    assert set_score.overlap(first, lifted) == 0
    second[2] = first[2]
    share = np.linspace(0, 1, 25)
    grid = np.stack(np.meshgrid(share - 0.5, share - 0.5), axis=-1).reshape(-1, 2) * EDGE
    inside = []
    for one, other in ((first, second), (second, first)):
        points = one[:2] + grid @ so3.exp([0, 0, one[3]])[:2, :2].T
        local = (points - other[:2]) @ so3.exp([0, 0, other[3]])[:2, :2]
        inside.append((np.abs(local) < EDGE / 2 - 1e-9).all(axis=1).any())
    reach = set_score.overlap(first, second)
    if any(inside):
        assert reach > 0
    if reach > 2e-3:
        assert any(inside)


def test_what_a_die_gains_is_what_the_whole_loses_without_it(views):
    for k in range(len(DICE_POSES)):
        gain = set_score.settle(views, DICE_POSES.copy(), k, np.empty(0), 0.0, CANVAS)
        lost = total(views, DICE_POSES) - total(views, np.delete(DICE_POSES, k, axis=0))
        assert gain == pytest.approx(lost, rel=1e-4)


def test_a_die_that_settles_far_away_gains_there_what_it_does_if_it_begins_there(views):
    away = DICE_POSES.copy()
    away[:, 0] += 0.02
    for k in range(len(DICE_POSES)):
        dice = np.where(np.arange(len(away))[:, None] == k, away, DICE_POSES)
        total(views, DICE_POSES)  # leaves all of them on the canvas, this one where it belongs
        gain = set_score.settle(views, dice, k, STEPS, 0.0, CANVAS)
        assert np.hypot(*(dice[k] - DICE_POSES[k])[:2]) < 2e-3
        assert gain == pytest.approx(set_score.settle(views, dice, k, STEPS[:0], 0.0, CANVAS), rel=1e-6)


def test_what_one_view_has_against_a_die_is_limited():
    first, second, third = (painted(camera, DICE_POSES)[1] for camera in RIG)
    seen, hidden, unknown = (
        total(views_of([first, mask, third]), DICE_POSES) for mask in (second, np.zeros_like(second), None)
    )
    assert hidden < unknown < seen
    assert unknown - hidden <= len(DICE_POSES) * set_score.HIDDEN


def test_evidence_tells_tops_from_sides_and_pips_from_blue():
    image, mask = painted(RIG[0], DICE_POSES)
    scores, seen, shade = evidence(mask, image)
    classes, _ = drawn(views_of([mask] * 3), DICE_POSES, 0)
    inner = (seen == DICE) & (scores[set_score.TOP] > 0)
    tops = inner & np.isin(classes, (set_score.TOP, set_score.TOP_RIM))
    sides = inner & np.isin(classes, (set_score.SIDE, set_score.SIDE_RIM))
    assert shade[tops].mean() > 0.4
    assert shade[sides].mean() < -0.2
    assert (scores[set_score.TOP] >= scores[set_score.TOP_RIM]).all()
    unknown = views_of([None] * 3)
    assert (unknown.masks == UNKNOWN).all()
    assert not unknown.scores.any()
