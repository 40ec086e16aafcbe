import numpy as np

from tests.helpers import random_rotations
from tracker.geometry import cuboid

SIZE = np.array([0.02, 0.08, 0.03])
CENTERS = cuboid.FACE_NORMALS * SIZE / 2


def test_corners_have_the_signs_of_their_bits_and_half_the_size_and_faces_the_normals_of_their_names():
    for k, corner in enumerate(cuboid.corners(SIZE)):
        signs = [1 if k & bit else -1 for bit in (1, 2, 4)]
        np.testing.assert_allclose(corner, np.multiply(signs, SIZE / 2))
    for name, normal in zip(cuboid.FACE_NAMES, cuboid.FACE_NORMALS, strict=True):
        axis = "xyz".index(name[1])
        assert normal[axis] == (1 if name[0] == "+" else -1)
        assert np.count_nonzero(normal) == 1


def test_every_edge_joins_neighbours_and_lies_in_both_its_faces_which_turn_counter_clockwise():
    corners = cuboid.corners(SIZE)
    assert len({tuple(sorted(edge[:2])) for edge in cuboid.EDGES.tolist()}) == 12
    for a, b, first, second in cuboid.EDGES:
        assert np.count_nonzero(corners[a] != corners[b]) == 1
        for face in (first, second):
            heights = (corners[[a, b]] - CENTERS[face]) @ cuboid.FACE_NORMALS[face]
            np.testing.assert_allclose(heights, 0, atol=1e-15)
    # Faces turn counter-clockwise, seen from outside.
    for face, ring in enumerate(cuboid.FACE_CORNERS):
        ring_corners = corners[ring]
        np.testing.assert_allclose(ring_corners.mean(axis=0), CENTERS[face], atol=1e-15)
        sides = np.roll(ring_corners, -1, axis=0) - ring_corners
        turns = np.cross(sides, np.roll(sides, -1, axis=0)) @ cuboid.FACE_NORMALS[face]
        assert (turns > 0).all()


def test_a_face_is_visible_where_the_ray_to_it_meets_no_other(rng):
    # A point on a face is seen if the segment to the camera leaves the box at once.
    for rotation in random_rotations(rng, 100):
        position = rotation @ [0.5, 0, 0]
        visible = cuboid.visible_faces(SIZE, position)
        for face in range(6):
            just_off = CENTERS[face] + 1e-9 * (position - CENTERS[face])
            assert visible[face] == (np.abs(just_off) > SIZE / 2).any()
    # From near by or inside, at most one of two opposite faces.
    for position in rng.uniform(-0.1, 0.1, size=(100, 3)):
        visible = cuboid.visible_faces(SIZE, position)
        assert not (visible[0::2] & visible[1::2]).any()
    assert not cuboid.visible_faces(SIZE, np.zeros(3)).any()
