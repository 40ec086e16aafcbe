import dataclasses

import numpy as np
import pytest

from tests.helpers import make_camera, numerical_jacobian, random_rotations
from tracker.geometry import so3
from tracker.geometry.cuboid import EDGES, FACE_NORMALS, corners, visible_faces
from tracker.geometry.lens import stack_lenses
from tracker.pose.strips import MAX_STRIPS, STRIP, edge_strips

CAMERA = make_camera()
LENSES = stack_lenses([CAMERA])
HALF = np.array([0.01, 0.04, 0.015])
LABELS = np.array([1, 5, 2, 6, 3, 4], dtype=np.uint8)
POSITION = np.array([0.02, -0.03, 0.05])
SPACING, MARGIN = 2.0, 3.0


def samples_at(rotation, position=POSITION, lenses=LENSES, spacing=SPACING, margin=MARGIN):
    out = np.empty(MAX_STRIPS, STRIP)
    n = edge_strips(lenses, 0, HALF, LABELS, rotation, position, spacing, margin, out)
    return out[:n]


def samples_by_edge(rng, count=10, camera=CAMERA, **settings):
    """For each edge of the cuboid in random rotations.

    Yields the rotation, the edge's row of EDGES, its corners' pixels (2, 2), its samples (n,) of STRIP, which
    lie on it.
    """
    share = np.linspace(0, 1, 1001)[:, None]
    for rotation in random_rotations(rng, count):
        samples = samples_at(rotation, lenses=stack_lenses([camera]), **settings)
        ends = corners(2 * HALF) @ rotation.T + POSITION
        for k, edge in enumerate(EDGES):
            start, end = ends[edge[:2]]
            own = samples[samples["edge"] == k]
            away = own["pixel"][:, None] - camera.project(start + share * (end - start))
            assert (np.linalg.norm(away, axis=-1).min(axis=1) < 0.1).all()
            yield rotation, edge, camera.project([start, end]), own


def faces_seen(rotation):
    return visible_faces(2 * HALF, rotation.T @ (CAMERA.position - POSITION))


def test_normals_are_unit_and_point_out_of_the_face_and_the_jacobian_is_the_motion_along_them(rng):
    # A sample that is found again on the moved object has moved along the edge too, but along the normal as
    # its columns say.
    for rotation in random_rotations(rng, 10):
        samples = samples_at(rotation)
        normals = samples["normal"]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
        outward = np.sum((samples["pixel"] - CAMERA.project([POSITION])) * normals, axis=1)
        assert (outward[samples["outside"] == 0] > 0).all()

        def along(change, rotation=rotation, normals=normals):
            moved = samples_at(so3.exp(change[3:]) @ rotation, POSITION + change[:3])
            return np.sum(moved["pixel"] * normals, axis=1)

        numeric = numerical_jacobian(along, np.zeros(6), 1e-5)
        np.testing.assert_allclose(samples["jacobian"], numeric, rtol=1e-4, atol=1e-3)
        # Also in large pictures samples stay within the work space.
        big = stack_lenses([CAMERA.resized(1080, 1080)])
        assert 0 < len(samples_at(rotation, np.array([0.0, 0.0, 0.1]), big, 0.5, 1.0)) <= MAX_STRIPS


def test_a_rim_ends_each_face_before_its_neighbours_plane(rng):
    # Outlines follow the border of the one face that is seen, inner edges the middle between two borders.
    rim, share = 1e-6, np.linspace(0, 1, 801)[:, None]
    for rotation, (a, b, *faces), _, samples in samples_by_edge(rng):
        seen, ends = faces_seen(rotation), corners(2 * HALF)[[a, b]]
        points = ends[0] + share * (ends[1] - ends[0])
        pixels = CAMERA.project(points @ rotation.T + POSITION)
        hidden = [face for face in faces if not seen[face]] or faces
        # A face's border is moved against the normal of the face beyond the edge.
        inward = -np.mean([FACE_NORMALS[face] for face in hidden], axis=0)
        moved = CAMERA.project((points + rim * inward) @ rotation.T + POSITION)
        for sample in samples:
            k = np.argmin(np.linalg.norm(pixels - sample["pixel"], axis=1))
            expected = (moved[k] - pixels[k]) @ sample["normal"] / rim
            assert sample["rim"] == pytest.approx(expected, rel=2e-2, abs=1.0)
            assert sample["rim"] < 0 or sample["outside"]  # outlines are drawn inwards


@pytest.mark.parametrize(("spacing", "margin"), [(2.0, 0.0), (2.0, 1.0), (2.0, 3.0), (4.0, 3.0), (6.0, 3.0)])
@pytest.mark.parametrize("distortion", [CAMERA.distortion, np.zeros(5)], ids=["bent", "straight"])
def test_pieces_are_about_as_long_as_asked_for_and_cover_the_edge(rng, distortion, spacing, margin):
    camera, settled = dataclasses.replace(CAMERA, distortion=distortion), 0
    for _, _, ends, samples in samples_by_edge(rng, camera=camera, spacing=spacing, margin=margin):
        if len(samples) > 0:
            length, piece, count = np.linalg.norm(ends[1] - ends[0]), samples["length"][0], len(samples)
            assert samples["length"].sum() == pytest.approx(length - 2 * margin, rel=1e-9)
            assert np.ptp(samples["length"]) == 0
            # Up to half a piece more or less, spread over all.
            assert count == 24 or abs(piece - spacing) * count <= 0.5 * spacing + 1e-9
            places = (samples["pixel"] - ends[0]) @ (ends[1] - ends[0]) / length
            # Perspective and a bent lens put the middle of a piece off the middle by a little.
            np.testing.assert_allclose(places, margin + piece * (np.arange(count) + 0.5), atol=0.05 * length)
            settled += 1
    assert settled > 50


def test_every_visible_edge_of_wide_faces_has_samples(rng):
    for rotation, edge, ends, samples in samples_by_edge(rng):
        faces, seen = edge[2:], faces_seen(rotation)
        if not seen[faces].any() or np.linalg.norm(ends[1] - ends[0]) < 2 * MARGIN + 0.5 * SPACING:
            assert len(samples) == 0
        elif len(samples) == 0:
            # Only a face that is seen at a grazing angle gives no edge.
            toward = CAMERA.position - POSITION
            slant = np.abs(rotation[:, faces // 2].T @ toward) / np.linalg.norm(toward)
            assert slant.min() < 0.35
        else:
            labels = {int(LABELS[f]) for f in faces if seen[f]}
            found = {*samples["inside"].astype(int), *samples["outside"].astype(int)} - {0}
            assert found == labels


def distance_across(face, edge, rotation, row):
    """Signed distance along a sample's normal to the face's edge opposite to `edge`; nan past its ends."""
    ends = corners(2 * HALF)[edge[:2]]
    axis = 3 - edge[2] // 2 - edge[3] // 2
    ends[:, 3 - axis - face // 2] *= -1
    start, end = CAMERA.project(ends @ rotation.T + POSITION)
    # pixel + t · normal = start + s · (end - start)
    t, s = np.linalg.solve(np.column_stack([row["normal"], start - end]), start - row["pixel"])
    return float(t) if 0 < s < 1 else np.nan


def test_reaches_are_how_far_the_surfaces_extend(rng):
    errors = []
    for rotation, edge, _, samples in samples_by_edge(rng, 20):
        seen = faces_seen(rotation)
        for row in samples:
            inside = next(f for f in edge[2:] if LABELS[f] == row["inside"])
            other = next(f for f in edge[2:] if f != inside)
            found = [(row["reach_in"], -distance_across(inside, edge, rotation, row))]
            assert seen[inside]
            if row["outside"] > 0:
                assert row["outside"] == LABELS[other]
                found.append((row["reach_out"], distance_across(other, edge, rotation, row)))
            else:
                assert not seen[other]
                assert row["reach_out"] > 500
            errors += [(stated - true) / max(true, 5.0) for stated, true in found]
    # Where the normal leaves the face through one of its other sides, the reach is no distance.
    met = np.abs(errors)[~np.isnan(errors)]
    assert len(met) > 500
    assert np.quantile(met, 0.9) < 0.02
    assert met.max() < 0.15
