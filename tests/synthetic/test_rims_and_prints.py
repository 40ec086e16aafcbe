import numpy as np
import pytest

pytest.importorskip("trimesh", reason="platform: no module trimesh")

import trimesh

from synthetic.scene import Body
from synthetic.world.chamfers import SEAM, SPREAD_M, WIDTH_M, group_faces, random_rims, rimmed_box, with_rims
from synthetic.world.meshes import box
from synthetic.world.prints import printed_mesh, random_prints, with_prints
from tracker.geometry.cuboid import EDGES, FACE_NORMALS

SIZES = [np.array([0.065, 0.065, 0.065]), np.array([0.02, 0.08, 0.02])]


def solid(mesh):
    result = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    result.merge_vertices(merge_tex=True, merge_norm=True)
    return result


def reach(mesh, directions):
    """How far the mesh reaches along directions (N, 3)."""
    return (directions @ np.asarray(mesh.vertices).T).max(axis=1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("cut", "lost"), [(False, np.sqrt(2) - 1), (True, 1 / np.sqrt(2))])
def test_rims_take_from_edges_what_geometry_says_and_nothing_from_faces(size, cut, lost):
    width = 0.0007
    mesh, sharp = rimmed_box(size, width, cut=cut), box(size)
    np.testing.assert_allclose(reach(mesh, FACE_NORMALS), reach(sharp, FACE_NORMALS), rtol=0, atol=1e-12)
    bisectors = (FACE_NORMALS[EDGES[:, 2]] + FACE_NORMALS[EDGES[:, 3]]) / np.sqrt(2)
    np.testing.assert_allclose(reach(sharp, bisectors) - reach(mesh, bisectors), width * lost, atol=1e-12)
    directions = np.random.default_rng(0).standard_normal((200, 3))
    assert (reach(mesh, directions) <= reach(sharp, directions) + 1e-12).all()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("printed", [False, True])
def test_rims_and_prints_leave_a_closed_surface_that_looks_outwards(size, cut, printed):
    mesh = rimmed_box(size, 0.0006, cut=cut)
    if printed:
        mesh = printed_mesh(mesh, 54, 0.0003, 0.002)
    whole = solid(mesh)
    assert whole.is_watertight
    assert whole.is_winding_consistent
    # What is lost is about the share of the edges' squares that the rim leaves out.
    assert 0.985 < whole.volume / np.prod(size) < 1.0
    np.testing.assert_allclose(solid(rimmed_box(size, 0.0006, cut=cut)).volume, whole.volume, rtol=1e-9)


@pytest.mark.parametrize("cut", [False, True])
def test_a_point_of_a_rim_has_the_label_of_the_face_it_looks_like(cut):
    mesh = rimmed_box(SIZES[0], 0.001, cut=cut)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own = (FACE_NORMALS[group_faces()[mesh.groups]] * normals).sum(axis=1)
    assert (own >= (normals @ FACE_NORMALS.T).max(axis=1) - 1e-12).all()


def test_rims_and_prints_keep_labels_and_pose_and_rims_are_about_as_wide_as_usual_and_dirty_by_any_share():
    rng, labels = np.random.default_rng(3), np.arange(1, 7, dtype=np.uint8)
    tidy = Body("cuboid", box(SIZES[0]), np.eye(4), np.full((6, 3), 0.3), labels)
    changed = with_prints(with_rims(tidy, random_rims(rng, 0.0005)), random_prints(rng))
    assert len(changed.labels) == len(changed.colors) == len(changed.coats) == 60
    assert len(changed.mesh.groups) == len(changed.mesh.triangles)
    assert set(np.unique(changed.mesh.groups)) == set(range(60))
    np.testing.assert_array_equal(changed.labels[:6], tidy.labels)
    np.testing.assert_array_equal(changed.labels[54:], tidy.labels)
    np.testing.assert_array_equal(changed.world_from_body, tidy.world_from_body)
    for usual in (0.0002, 0.0005, 0.0009):
        rims = [random_rims(rng, usual) for _ in range(300)]
        widths = np.array([one.width for one in rims])
        assert (widths >= max(usual - SPREAD_M, 0)).all()
        assert (widths <= WIDTH_M).all()
        assert np.median(widths) == pytest.approx(usual, abs=0.0002)
        dirty = np.array([(one.dirt < 1).mean() for one in rims])
        assert dirty.min() < 0.1
        assert dirty.max() > 0.9
        assert max(one.dirt[one.dirt < 1].max(initial=0.0) for one in rims) <= SEAM[1]


@pytest.mark.parametrize("size", [*SIZES, np.full(3, 0.005)])
def test_a_print_covers_its_face_up_to_the_margin_and_the_rounded_corners(size):
    margin, corner = 0.0005, 0.003
    mesh = printed_mesh(box(size), 6, margin, corner)
    corner = min(corner, size.min() / 2 - margin)  # of a small face it is a disc
    triangles = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).area_faces
    areas = np.bincount(mesh.groups, triangles, minlength=12)
    for face in range(6):
        sides = np.delete(size, face // 2)
        np.testing.assert_allclose(areas[face] + areas[6 + face], np.prod(sides), rtol=1e-9)
        # An arc of three segments lies within the circle by 1.1 % of its quarter's area.
        whole = np.prod(sides - 2 * margin) - (4 - np.pi) * corner**2
        np.testing.assert_allclose(areas[face], whole, rtol=0, atol=0.05 * np.pi * corner**2)
