import dataclasses
import os
import shutil
import time

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers import LENSES, make_camera
from tests.helpers.pose_logs import arrays_of, assert_same, make_about, random_poses
from tests.helpers.reading import attribute, change, datasets, edit, made, put, unpacking_to, without
from tracker.calibration.rig import CameraRig
from tracker.errors import LogError, TrackerError
from tracker.geometry.arena import Arena
from tracker.poses.columns import FilteredColumns
from tracker.poses.file import FORMAT, GROUPS, MAX_FRAMES, read_poses, write_poses
from tracker.poses.poses import KINDS


@pytest.fixture
def path(tmp_path):
    return tmp_path / "poses.h5"


@pytest.fixture
def written(path, rng):
    """A file of five frames that have all poses but those of frame 2."""
    write_poses(path, random_poses(rng, 5, share=[1, 1, 0, 1, 1]))
    return path


@settings(max_examples=20)
@given(
    count=st.integers(0, 12),
    share=st.sampled_from([0.0, 0.5, 1.0]),
    recorded=st.booleans(),
    cameras=st.booleans(),
    first=st.integers(0, 2**39),
    source=st.sampled_from(["", "ä 物体", "x" * 5000]),
    statuses=st.sampled_from([("", "größer"), ("tracking", "lost")]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_file_gives_back_what_was_written_to_the_bit(
    tmp_path_factory, count, share, recorded, cameras, first, source, statuses, seed
):
    path = tmp_path_factory.mktemp("poses") / "poses.h5"
    rng = np.random.default_rng(seed)
    poses = random_poses(rng, count, share=share, recorded=recorded, first=first, cameras=cameras)
    status = np.array(statuses)[rng.integers(2, size=count)]
    poses = dataclasses.replace(poses, status=status, about=make_about(source=source))
    write_poses(path, poses)
    assert_same(read_poses(path), poses)


def test_a_file_that_this_process_has_open_can_be_read(written):
    expected = read_poses(written)
    with h5py.File(written):
        assert_same(read_poses(written), expected)


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
    assert poses.about.rig.agrees_with(rig)


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
    with h5py.File(written) as ours, h5py.File(real / "logs" / "tricamera_log_with_pose.h5") as theirs:
        shared = {*datasets(ours)} & {*datasets(theirs)} - {"timestamps"}
        for name in shared:
            if name != "camera_names":  # texts: there of variable length
                assert ours[name].dtype == theirs[name].dtype, name
            per_frame = name.startswith("object_pose")
            assert ours[name].shape[per_frame:] == theirs[name].shape[per_frame:], name
    assert len(shared) == 4 + 3 * 3 + 1


def test_what_other_versions_add_or_lack_is_passed_over_whatever_the_files_name(written, tmp_path):
    before, other = read_poses(written), tmp_path / "ä poses"
    shutil.copy(written, other)
    with h5py.File(other, "r+") as file:
        file["object_pose/temperature"] = np.zeros(5)
        file["more"] = "text"
        file.attrs["remark"] = "later versions may add things"
    assert_same(read_poses(other), before)
    change(other, without("cameras"))
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


def log_of_the_platform(file):
    file.attrs.pop("format")
    file.attrs["magic"] = 0x3CDA7A00


def of_another_file(file):
    layout = h5py.VirtualLayout((5,), float)
    layout[:] = h5py.VirtualSource("other.h5", "stamps", (5,))
    del file["timestamps"]
    file.create_virtual_dataset("timestamps", layout)


def as_a_link_to_a_group(file):
    file.move("object_pose", "really")
    file["object_pose"] = h5py.SoftLink("/really")


CAMERA = "camera_info/camera60"
BREAKS = [
    (log_of_the_platform, "found a log of the platform"),
    (attribute("format"), "format: found no such attribute, expected texts"),
    (attribute("format", 3), "format: found int64"),
    (attribute("format", np.bytes_(b"poses")), "format: found 'poses'"),
    (attribute("source", np.bytes_(b"\xff")), "cannot be read.*utf-8"),
    (attribute("format_version", 2), "format_version: found 2, expected 1"),
    (attribute("format_version", "1"), "format_version: found object of shape .*expected whole"),
    (attribute("source"), "source: found no such attribute"),
    (attribute("object", np.zeros(3)), "object: found float64 .*expected texts"),
    (without("frame"), "/frame: found nothing, expected a dataset"),
    (put("frame", 5), r"/frame: found shape \(\), expected \(n,\)"),
    (put("frame", np.arange(5.0)), r"/frame: found float64 of shape \(5,\), expected whole"),
    (put("frame", np.arange(4)), r"/timestamps: found float64 of shape \(5,\), .*\(4,\)"),
    (made("frame", (10**12,), np.int64, chunks=(1000,)), "/frame: found shape .*with n up to 2000000"),
    (
        made("frame", (MAX_FRAMES,), np.int64, chunks=(1000,), compression="gzip"),
        f"/frame: found 0 bytes stored, .*for {8 * MAX_FRAMES}",
    ),
    (edit("frame", 3, 0), "/frame: row 3: found 0"),
    (edit("timestamps", 2, np.nan), "/timestamps: row 2: found nan"),
    (put("timestamps", np.zeros((5, 3))), r"/timestamps: found float64 of shape \(5, 3\)"),
    (edit("status", 1, 9), "/status: found code 9, expected codes below 2"),
    (attribute("names", at="status"), "/status: names: found no such"),
    (attribute("names", "lost", at="status"), r"/status: names: found object of shape \(\)"),
    (attribute("names", np.arange(2), at="status"), "/status: names: found int64"),
    (edit("cameras", (1, 2), 9), "/cameras: found code 9, expected codes below"),
    (put("cameras", np.zeros((5, 2), np.uint8)), r"/cameras: found uint8 of shape \(5, 2\), .*\(5, 3\)"),
    (put("cameras", np.zeros((5, 3))), r"/cameras: found float64 of shape \(5, 3\)"),
    (attribute("names", at="cameras"), "/cameras: names: found no such"),
    (without("object_pose"), "/object_pose/has_pose: found nothing"),
    (without("filtered_object_pose/velocity"), "filtered_object_pose/velocity: found nothing"),
    (without("recorded_object_pose/position"), "/recorded_object_pose/position: found nothing"),
    (put("object_pose/has_pose", np.ones(5)), "/object_pose/has_pose: found float64"),
    (put("object_pose/position", np.array([b"a"] * 5)), r"/object_pose/position: found \|S1"),
    (edit("object_pose/position", (1, 0), np.inf), "/object_pose/position: row 1: found inf"),
    (edit("filtered_object_pose/confidence", 0, -0.1), "/filtered_object_pose/confidence: row 0: found -0.1"),
    (without("camera_names"), "/camera_names: found nothing"),
    (put("camera_names", np.arange(3)), "/camera_names: found int64"),
    (put("camera_names", np.array([b"a"])), "/camera_info/a: found none, expected a group"),
    (without(f"{CAMERA}/camera_matrix"), f"/{CAMERA}/camera_matrix: found nothing"),
    (edit(f"{CAMERA}/camera_matrix", (0, 0), -1), "camera60: camera_matrix: found focal lengths -1"),
    (attribute("image_width", at=CAMERA), f"/{CAMERA}: image_width: found no such"),
    # What other files hold is never read.
    (put("timestamps", h5py.ExternalLink("other.h5", "/stamps")), "/timestamps: found a link"),
    (put("timestamps", h5py.SoftLink("/object_pose/confidence")), "/timestamps: found a link"),
    (made("timestamps", (5,), float, external=[("other.h5", 0, 40)]), "/timestamps: found data outside"),
    (of_another_file, "/timestamps: found data outside"),
    (as_a_link_to_a_group, "/object_pose/has_pose: found a link"),
    # Nor what would fill the memory.
    (unpacking_to("timestamps"), "/timestamps: .*unpacks to"),
    (unpacking_to("timestamps", sums=True), "/timestamps: .*unpacks to"),
    (unpacking_to("timestamps", 39), "/timestamps: .*found 39 bytes, expected 40"),
    (made("camera_names", (300,), "S1000000"), "/camera_names: found 0 bytes stored, .*for 300000000"),
    (attribute("source", np.bytes_(b"x" * (2 << 20))), "source: found .*expected at most 1048576 bytes"),
]


@pytest.mark.parametrize(("harm", "message"), BREAKS)
def test_what_cannot_be_is_refused_with_file_and_dataset(written, harm, message):
    with h5py.File(written.parent / "other.h5", "w") as other:
        other["stamps"] = np.arange(5.0)
    with h5py.File(written, "r+", libver=("v110", "v110")) as file:
        harm(file)
    with pytest.raises(LogError, match=rf"poses\.h5: .*{message}"):
        read_poses(written)


def test_what_is_no_hdf5_and_what_is_no_file_is_refused(path, tmp_path):
    for content in (b"", b"text", b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n" + bytes(3000)):
        path.write_bytes(content)
        with pytest.raises(LogError, match=r"poses\.h5: cannot be read"):
            read_poses(path)
    for path in (tmp_path / "none.h5", tmp_path):
        with pytest.raises(LogError, match=r"found (no such file|a folder), expected a file of poses"):
            read_poses(path)
    with pytest.raises(LogError, match="found a null byte in it, expected a path"):
        read_poses(str(tmp_path / "nul\0.h5"))


def test_a_damaged_byte_is_refused_or_changes_nothing(written, tmp_path):
    """There are checksums wherever something is written; the rest is unused space."""
    before, content = arrays_of(read_poses(written)), written.read_bytes()
    rng = np.random.default_rng(1)
    damaged = tmp_path / "damaged.h5"
    refused = 0
    for place in rng.integers(0, len(content), 30):
        broken = bytearray(content)
        broken[place] ^= 1 << rng.integers(8)
        damaged.write_bytes(bytes(broken))
        try:
            np.testing.assert_equal(arrays_of(read_poses(damaged)), before, err_msg=str(place))
        except TrackerError:
            refused += 1
    assert refused > 20


INDEFINITE, ASYMMETRIC = np.eye(6), np.eye(6)
INDEFINITE[0, 1] = INDEFINITE[1, 0] = 1.01
ASYMMETRIC[0, 1] = 0.01


@pytest.mark.parametrize(
    ("name", "rows", "value", "message"),
    [
        ("position", (1, 2), np.nan, "row 1: found .* nan, expected finite"),
        ("position", 2, 0.0, "row 2: found 0 0 0, expected NaN"),
        ("position", None, np.zeros((3, 2)), r"found shape \(3, 2\), .* \(3, 3\)"),
        ("position", None, "text", "found 'text', expected numbers"),
        ("orientation", 1, 0.0, "row 1: found 0 0 0 0, expected a quat"),
        ("orientation", 0, 0.4, "row 0: .*length 1"),
        ("confidence", 0, 1.001, "row 0: found 1.001, expected a prob"),
        ("confidence", 0, np.nan, "row 0: found nan, expected finite"),
        ("covariance", 1, ASYMMETRIC, "row 1: .*expected a symmetric"),
        ("covariance", 1, INDEFINITE, "row 1: .*positive semi-definite"),
        ("covariance", 0, 1e-12 * INDEFINITE, "row 0: .*positive semi-definite"),
        ("covariance", 0, 1e12 * INDEFINITE, "row 0: .*positive semi-definite"),
        ("covariance", (0, 0, 0), -1e-12, "row 0: .*not negative"),
        ("covariance", None, np.zeros((2, 6, 6)), r"found shape \(2, 6, 6\)"),
        ("velocity", (0, 0), np.inf, "row 0: found inf"),
        ("velocity_covariance", 1, INDEFINITE, "row 1: .*positive semi-definite"),
        ("has_pose", None, np.ones(3), "found float64"),
        ("has_pose", None, np.ones((3, 1), bool), r"found bool of shape \(3, 1\)"),
    ],
)
def test_impossible_rows_and_columns_of_another_shape_or_type_are_refused(rng, name, rows, value, message):
    columns = FilteredColumns.joined([random_poses(rng, 2, share=1).filtered, FilteredColumns.nothing(1)])
    arrays = {name: array.copy() for name, array in columns.arrays().items()}
    for scale in (1e-12, 1.0, 1e12):
        FilteredColumns(**{**arrays, "covariance": scale * arrays["covariance"]})
    if rows is None:
        arrays[name] = value
    else:
        arrays[name][rows] = value
    with pytest.raises(LogError, match=f"{name}: {message}"):
        FilteredColumns(**arrays)
