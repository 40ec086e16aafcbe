import dataclasses
import os
import shutil
import time

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import LENSES, make_camera
from tests.helpers.pose_logs import assert_same, make_about, random_poses
from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.geometry.arena import Arena
from tracker.poses.file import FORMAT, GROUPS, read_poses, write_poses
from tracker.poses.poses import KINDS


@given(
    count=st.integers(0, 12),
    share=st.sampled_from([0.0, 0.5, 1.0]),
    recorded=st.booleans(),
    cameras=st.booleans(),
    first=st.integers(0, 2**39),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_file_gives_back_what_was_written_to_the_bit(
    tmp_path_factory, count, share, recorded, cameras, first, seed
):
    path = tmp_path_factory.mktemp("poses") / "poses.h5"
    rng = np.random.default_rng(seed)
    poses = random_poses(rng, count, share=share, recorded=recorded, first=first, cameras=cameras)
    write_poses(path, poses)
    assert_same(read_poses(path), poses)


def test_cameras_and_arena_come_back_with_and_without_deviations(path, rng):
    other = dataclasses.replace(make_camera(60, "links ä"), distortion=np.array(LENSES[14]))
    cameras = (make_camera(300), dataclasses.replace(other, camera_from_world_std=None))
    poses = random_poses(rng, 2, cameras=False)
    poses = dataclasses.replace(poses, about=make_about(rig=CameraRig(cameras, Arena((10.0, -3.0)))))
    write_poses(path, poses)
    rig = read_poses(path).about.rig
    assert rig.arena == Arena((10.0, -3.0))
    assert rig.names == ("camera300", "links ä")
    assert rig[1].camera_from_world_std is None
    np.testing.assert_array_equal(rig[1].distortion, LENSES[14])
    assert poses.about.agrees_with(read_poses(path).about)


@pytest.mark.parametrize("source", ["", "ä 物体", "x" * 5000])
def test_texts_come_back(path, rng, source):
    poses = dataclasses.replace(random_poses(rng, 2), about=make_about(source=source))
    write_poses(path, dataclasses.replace(poses, status=np.array(["", "größer"])))
    assert read_poses(path).about.source == source
    assert read_poses(path).status.tolist() == ["", "größer"]


def test_the_names_are_those_of_the_platforms_logs_and_texts_have_codes(written):
    with h5py.File(written) as file:
        assert "magic" not in file.attrs  # it is no log
        shapes = {name: field.shape[1:] for name, field in file["object_pose"].items()}
        assert file["object_pose/has_pose"].dtype == np.bool_
        expected = {"has_pose": (), "position": (3,), "orientation": (4,), "confidence": ()}
        assert shapes == {**expected, "covariance": (6, 6)}
        for number, name in enumerate(("camera60", "camera180", "camera300")):
            group = file["camera_info"][name]
            assert group["camera_matrix"].shape == (3, 3)
            assert group["distortion_coefficients"].shape == (1, 5)
            assert group["tf_world_to_camera"].shape == (4, 4)
            assert file["camera_names"][number] == name.encode()
        texts = {}
        for name in ("status", "cameras"):
            names, codes = file[name].attrs["names"], file[name]
            assert codes.dtype == np.uint8
            texts[name] = np.vectorize(lambda code, names=names: names[code].decode())(codes[()]).tolist()
    assert texts["status"] == ["tracking"] * 2 + ["lost"] + ["tracking"] * 2
    assert texts["cameras"] == read_poses(written).cameras.tolist()
    assert texts["cameras"][2] == [""] * 3


def test_the_names_fit_the_platforms_own_log(written, real):
    """Datasets that both files have are of the same type and row."""
    shared = []
    with h5py.File(written) as ours, h5py.File(real / "logs" / "tricamera_log_with_pose.h5") as theirs:

        def compare(name, item):
            if isinstance(item, h5py.Dataset) and name in ours and name != "timestamps":
                shared.append(name)
                if name != "camera_names":  # texts: there of variable length
                    assert ours[name].dtype == item.dtype, name
                per_frame = name.startswith("object_pose")
                assert ours[name].shape[per_frame:] == item.shape[per_frame:], name

        theirs.visititems(compare)
    assert len(shared) == 4 + 3 * 3 + 1


def test_what_other_versions_add_or_lack_is_passed_over_whatever_the_files_name(written, tmp_path):
    before, other = read_poses(written), tmp_path / "ä poses"
    shutil.copy(written, other)
    with h5py.File(other, "r+") as file:
        file["object_pose/temperature"] = np.zeros(5)
        file["more"] = "text"
        file.attrs["remark"] = "later versions may add things"
    assert_same(read_poses(other), before)
    with h5py.File(other, "r+") as file:
        del file["cameras"]
    assert_same(read_poses(other), dataclasses.replace(before, cameras=None))


def test_statuses_and_uses_of_older_files_are_read_in_todays_spelling(written):
    statuses = {"tracking": "no object colours", "lost": "inconsistent views"}
    old = {"status": statuses, "cameras": {"used": "no image"}}
    before = read_poses(written)
    with h5py.File(written, "r+") as file:
        for name, spelled in old.items():
            names = [spelled.get(text.decode(), text.decode()) for text in file[name].attrs["names"]]
            file[name].attrs["names"] = np.array(names, dtype="S")
    poses = read_poses(written)
    today = np.where(before.status == "lost", "inconsistent_views", "no_object_colors")
    assert poses.status.tolist() == today.tolist()
    assert poses.cameras.tolist() == np.where(before.cameras == "used", "no_image", before.cameras).tolist()


def test_more_statuses_than_codes_are_refused_and_leave_the_old_file(path, rng):
    poses = random_poses(rng, 257)
    poses = dataclasses.replace(poses, status=np.array([f"status {k}" for k in range(257)]))
    write_poses(path, poses[:256])
    before = path.read_bytes()
    with pytest.raises(LogError, match="found 257 different ones"):
        write_poses(path, poses)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]
    assert read_poses(path).status.tolist() == poses.status[:256].tolist()


def test_every_dataset_and_attribute_stands_on_the_format_page(written, request):
    page = (request.config.rootpath / "docs" / "poses.md").read_text(encoding="utf-8")
    assert FORMAT in page
    with h5py.File(written) as file:
        names = [*file, *file.attrs, *file["camera_info/camera60"], *file["camera_info/camera60"].attrs]
    for name in (*names, *GROUPS.values(), *KINDS["filtered"].ROW_SHAPES):
        assert f"`{name}`" in page or f"`/{name}`" in page, name


def test_neither_the_time_nor_when_python_forgets_what_it_wrote_shows(rng, tmp_path, monkeypatch):
    poses = random_poses(rng, 5)
    write_poses(tmp_path / "one.h5", poses)
    time.sleep(1.01)  # what a file says of its time is in seconds
    kept, create = [], h5py.Group.create_dataset

    def keeping(self, *arguments, **options):
        dataset = create(self, *arguments, **options)
        kept.append(dataset)
        return dataset

    monkeypatch.setattr(h5py.Group, "create_dataset", keeping)
    write_poses(tmp_path / "two.h5", poses)
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()
