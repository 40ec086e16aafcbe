import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers import RIG
from tests.helpers.kept_stills import take
from tests.helpers.stills import posed_scene
from tracker.calibration.by_object.edges import EdgeReader
from tracker.geometry import so3

MODEL = tracker.load_object("cube_v2")
POSE = np.array([0.03, -0.04, 0.0325]), so3.exp([0.0, 0.0, 0.5])


@pytest.fixture(scope="module")
def seen():
    """A reader of edges, what it sees of a cube, and where it is refined to."""
    rng = np.random.default_rng(3)
    still = take(posed_scene(MODEL, POSE, rng), RIG.cameras, Sensor.realistic(), rng)
    reader = EdgeReader(MODEL, RIG, tracker.load_colors(MODEL.colors))
    sight = reader._reader(still.images)
    return reader, sight, reader._refiner(sight, POSE[1], POSE[0])


def at(seen, moved):
    reader, sight, refined = seen
    rotation, position = so3.exp(moved[3:]) @ refined.rotation, refined.position + moved[:3]
    return reader.contours(sight, rotation, position, refined.end)


def left_of(contour, end):
    """What bloom and rim leave of its offsets."""
    return contour.offset - contour.bloom * end.exponent - contour.rim * end.rim


def test_at_the_refined_pose_nothing_is_left(seen):
    for contour in at(seen, np.zeros(6)):
        assert len(contour.offset) > 20
        assert abs(np.median(left_of(contour, seen[2].end))) < 0.05
        assert (contour.variance > 0).all()
    # A camera without a picture hands out nothing.
    reader, sight, refined = seen
    found = reader.contours(sight.without(0), refined.rotation, refined.position, refined.end)
    assert [contour is None for contour in found] == [True, False, False]


def solved(seen, moved):
    """(6,) change of a moved pose that the offsets ask for, all edges being where the model has them."""
    contours = at(seen, moved)
    rows = np.concatenate([one.jacobian / np.sqrt(one.variance)[:, None] for one in contours])
    values = np.concatenate([left_of(one, seen[2].end) / np.sqrt(one.variance) for one in contours])
    return np.linalg.lstsq(rows, values, rcond=None)[0]


def test_offsets_tell_by_how_much_a_pose_is_off(seen):
    rng, rest = np.random.default_rng(4), solved(seen, np.zeros(6))
    for _ in range(3):
        moved = rng.normal(size=6) * np.repeat([0.4e-3, 0.005], 3)
        back = solved(seen, moved) - rest
        # One step of what is not linear: 0.07 mm are left of moves by 0.6 mm, 0.03 mm of half such moves.
        np.testing.assert_allclose(back[:3], -moved[:3], atol=0.08e-3)
        np.testing.assert_allclose(back[3:], -moved[3:], atol=2e-3)
