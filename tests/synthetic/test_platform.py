import numpy as np
import pytest

from synthetic.world import assets

pytest.importorskip("trimesh", reason="platform: no module trimesh")
pybullet = pytest.importorskip("pybullet", reason="platform: no module pybullet")

from synthetic.look.appearance import random_lighting, random_look  # noqa: E402
from synthetic.world import kinematics  # noqa: E402 - these need pybullet
from synthetic.world.platform import Platform  # noqa: E402
from tests.helpers import stills  # noqa: E402


@pytest.fixture(scope="module")
def platform():
    return stills.platform("cube_v2")


LIMITS = np.tile(kinematics.LOWER_LIMITS, 3), np.tile(kinematics.UPPER_LIMITS, 3)


def test_tips_and_limits_are_those_of_pybullet_and_tips_lead_back_to_the_joint_angles(platform, rng):
    for _ in range(100):
        joints = rng.uniform(*LIMITS)
        platform.world.set_joints(joints)
        tips = kinematics.tips(joints)
        expected = [platform.world.link_pose(links[-1])[:3, 3] for links in platform.world.finger_links]
        np.testing.assert_allclose(tips, expected, atol=1e-6)
        for finger in range(3):
            found = kinematics.finger_angles(finger, tips[finger])
            assert found is not None
            np.testing.assert_allclose(found, joints[3 * finger : 3 * finger + 3], atol=1e-6)
    for out_of_reach in ([0.0, 0.0, 2.0], [0.0, 0.0, 0.29]):
        assert kinematics.finger_angles(0, np.array(out_of_reach)) is None
    world = platform.world
    limits = [pybullet.getJointInfo(world.robot, j, physicsClientId=world.client)[8:10] for j in world.joints]
    np.testing.assert_allclose(np.transpose(limits), LIMITS)


def test_bodies_of_a_scene_are_where_pybullet_has_the_links_and_their_meshes_end_at_the_tips(platform, rng):
    joints, states = rng.uniform(*LIMITS), platform.object_states(np.zeros((1, 3)), np.eye(3)[None])
    look, lighting = random_look(rng, platform.model), random_lighting(rng)
    bodies = platform.scene(states, joints, look, lighting, {}).bodies
    poses = {body.name: body.world_from_body for body in bodies}
    world = platform.world
    seen = {link: poses[name] for link, name in world.links.items() if name in poses}
    assert len(seen) == 19
    for link, pose in seen.items():
        state = pybullet.getLinkState(world.robot, link, 0, True, physicsClientId=world.client)
        np.testing.assert_allclose(pose[:3, 3], state[4], atol=1e-9)
        matrix = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        np.testing.assert_allclose(pose[:3, :3], matrix, atol=1e-6)
    for finger, tip in enumerate(kinematics.tips(joints)):
        (body,) = (body for body in bodies if body.name == f"finger_tip_link_{120 * finger}")
        distance = np.linalg.norm(body.points - tip, axis=1)
        assert distance.min() == pytest.approx(kinematics.TIP_RADIUS, abs=1e-4)
    meshes = {}  # of one key are equal
    for body in bodies:
        assert body.mesh.groups.max() < len(body.colors) == len(body.labels)
        assert len(body.mesh.groups) == len(body.mesh.triangles)
        assert body.mesh.triangles.max() < len(body.mesh.vertices)
        assert ((body.colors >= 0) & (body.colors <= 1)).all()
        other = meshes.setdefault(body.mesh.key, body.mesh)
        np.testing.assert_array_equal(other.vertices, body.mesh.vertices)


def test_several_platforms_live_side_by_side(platform):
    with Platform("cuboid_2x2x8_v2") as other:
        assert other.world.client != platform.world.client
        platform.world.set_joints(np.zeros(9))
    platform.world.set_joints(np.ones(9))
    np.testing.assert_allclose(platform.world.joint_angles(), 1.0)


def test_a_world_that_nobody_closes_is_freed(platform):
    client = platform.new_world(robot=False).client
    assert not pybullet.isConnected(client)


def test_a_chosen_folder_without_the_files_or_of_another_name_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv(assets.VARIABLE, str(tmp_path))
    with pytest.raises(assets.AssetError, match=r"TRIFINGER_ASSETS.*trifingerpro\.urdf"):
        assets.find_assets()
    for name in assets.FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(assets.AssetError, match="another name, expected robot_properties_fingers"):
        assets.find_assets()


def test_a_download_that_fails_says_what_to_do_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.delenv(assets.VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(assets, "_installed", lambda: None)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "nowhere"))
    with pytest.raises(assets.AssetError, match=assets.VARIABLE):
        assets.find_assets()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
