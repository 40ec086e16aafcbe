import itertools
from pathlib import Path

import h5py
import numpy as np
import pytest

import tracker
from tests.helpers import make_rig
from tests.helpers.log_writers import CAMERAS, make_content, write_hdf5
from tests.helpers.reading import (
    attribute,
    change,
    edit,
    frames_of,
    made,
    peak_memory,
    put,
    recovered,
    unpacking_to,
    without,
)
from tests.logs.test_native import SAMPLES as NATIVE
from tests.logs.test_native import assert_same
from tracker.errors import LogError

SAMPLES = ("tricamera_log_v2_1.h5", "tricamera_log_with_pose.h5")


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (2, 1)])
@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("chunk", [None, 1, 3])
def test_every_version_is_read(tmp_path, version, poses, chunk):
    content = make_content(7)
    path = write_hdf5(tmp_path / "log.h5", content, version=version, poses=poses, chunk=chunk)
    with tracker.open_log(path) as log:
        assert len(log) == 7
        assert f"version {version[0]}.{version[1]}" in log.format
        assert log.image_sizes == ((28, 24),) * 3
        assert log.camera_names == CAMERAS
        assert_same(log, content, poses=int(poses), stamped=version == (2, 1))
        assert (log.rig is not None) == (version[0] == 2)
        np.testing.assert_array_equal(log[5].images, content.images(5))
        assert [frame.index for frame in log[2:4]] == [2, 3]
        assert log.fault is None


@pytest.mark.parametrize(
    ("has_pose", "wide", "names", "rate"),
    list(itertools.product([True, False], [True, False], [True, False], ["none", "group", "root"])),
)
def test_what_some_writers_leave_out_is_not_missed(tmp_path, has_pose, wide, names, rate):
    content = make_content(3)
    options = {"has_pose": has_pose, "wide_confidence": wide, "names": names, "frame_rate": rate}
    with tracker.open_log(write_hdf5(tmp_path / "log.h5", content, poses=True, **options)) as log:
        assert_same(log, content, poses=1)
        assert log.rig.names == CAMERAS


def test_the_calibration_inside_is_read_and_mended(tmp_path):
    with tracker.open_log(write_hdf5(tmp_path / "log.h5", make_content(1))) as log:
        camera = log.rig[1]
    assert (camera.name, camera.width, camera.height) == ("camera180", 28, 24)
    assert camera.matrix[1, 2] == 11.5
    assert camera.distortion[0] == -0.2
    rotation = camera.camera_from_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    make_rig().save(tmp_path)
    with tracker.open_log(write_hdf5(tmp_path / "old.h5", make_content(1), version=(1, 0))) as log:
        assert log.rig.names == CAMERAS  # there is none inside


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (attribute("magic", 1), "magic: found 0x1, expected 0x3cda7a00"),
        (attribute("format_version", 3), "format_version: found 3, expected 1 or 2"),
        (attribute("image_width", 99), "image_width: found 99, expected 28"),
        (without("images"), "images is missing"),
        (without("timestamps"), "timestamps is missing"),
        (without("object_pose/position"), "position, orientation and confidence together"),
        (put("timestamps", np.zeros((3, 3))), r"fields of \[3, 4\] frames"),
        (put("timestamps", np.zeros((4, 3), "f4")), r"found float32 .* expected float64, bool"),
        (put("images", np.zeros((4, 3, 24, 28))), "float64 of shape"),
        (put("images", h5py.ExternalLink("/etc/passwd", "/images")), "found a link"),
        (made("images", (4, 3, 24, 28), np.uint8, external=[("/dev/zero", 0, 8064)]), "outside"),
        (put("camera_names", [b"camera60", b"camera60", b"camera300"]), "3 different names"),
        (made("camera_names", data=[b"a", b"b", b"c"], chunks=(3,)), "expected 3 contiguous names"),
        (made("timestamps", data=np.ones((4, 3)), scaleoffset=1), "packed with filter 6, expected gzip"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, harm, message):
    path = write_hdf5(tmp_path / "log.h5", make_content(4), poses=True)
    change(path, harm)
    with pytest.raises(LogError, match=message):
        tracker.open_log(path)


def shortened(path: Path) -> None:
    change(path, put("timestamps", make_content(4).camera_stamps))


def never_written(path: Path) -> None:
    images = {"shape": (5, 3, 24, 28), "dtype": np.uint8, "chunks": (1, 3, 24, 28), "compression": "gzip"}
    change(path, made("images", **images), *(edit("images", k, 50) for k in (0, 2, 3, 4)))


def damaged(path: Path) -> None:
    with h5py.File(path) as file:
        block = file["images"].id.get_chunk_info(2)
    data = bytearray(path.read_bytes())
    data[block.byte_offset + block.size // 2] ^= 4
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("harm", "frames", "message"),
    [
        (shortened, [0, 1, 2, 3], "frames, expected one number"),
        (never_written, [0, 2, 3, 4], "frame 1: images"),
        (damaged, [0, 1, 3, 4], "frame 2: images"),
        (lambda path: path.write_bytes(path.read_bytes() + b"x"), [0, 1, 2, 3, 4], "that the file states"),
    ],
)
def test_damage_costs_the_frames_that_it_meets_only(tmp_path, harm, frames, message):
    path = write_hdf5(tmp_path / "log.h5", make_content(5))
    harm(path)
    before, after = recovered(path, message)
    assert after == frames
    assert before == frames[: len(before)]


@pytest.mark.parametrize("name", ["images", "timestamps", "object_pose/confidence"])
@pytest.mark.parametrize("chunk", [None, 2])
def test_what_was_never_written_is_not_read_as_zeros(tmp_path, name, chunk):
    path = write_hdf5(tmp_path / "log.h5", make_content(5), poses=True)
    with h5py.File(path, "r+") as file:
        values = file[name][:]
        del file[name]
        field = file.create_dataset(
            name, values.shape, values.dtype, chunks=chunk and (chunk, *values.shape[1:])
        )
        if chunk:
            field[:4] = values[:4]
    with pytest.raises(LogError, match=f"{name}: (found 0 bytes stored|cannot be read)") as raised:
        frames_of(path)
    assert str(raised.value).count(str(path)) == 1


FILTERS = {}, {"compression": "gzip", "shuffle": True}, {"fletcher32": True}


@pytest.mark.parametrize(
    "packing",
    [
        {"chunks": None},
        *[{"chunks": (chunk, 3, 24, 28), "compression": "gzip"} for chunk in (1, 2, 3, 7)],
        *[{"chunks": (2, 2, 7, 9), **filters} for filters in FILTERS],
    ],
)
def test_images_may_be_packed_in_blocks_of_any_shape_and_may_be_changed(tmp_path, packing):
    content = make_content(7)
    path = write_hdf5(tmp_path / "log.h5", content)
    change(path, made("images", data=content.raw, **packing))
    with tracker.open_log(path) as log:
        for k in (6, 6, 0, 3, 3):
            raw = log[k].raw
            np.testing.assert_array_equal(np.array(raw), content.raw[k])
            for pixels in raw:
                pixels[:] = 0


@pytest.mark.parametrize("name", ["images", "timestamps"])
def test_a_block_that_unpacks_to_more_than_it_should_is_refused_before(tmp_path, name):
    path = write_hdf5(tmp_path / "log.h5", make_content(3))
    change(path, unpacking_to(name))
    with peak_memory() as used, pytest.raises(LogError, match=f"{name}.*unpacks to"):
        frames_of(path)
    assert used[0] < 5_000_000


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize(
    "changed", [lambda data: data[:-1], lambda data: data[:40], lambda data: data[:8] + data]
)
def test_a_file_that_ends_too_early_or_has_an_unknown_head_is_refused(tmp_path, changed, recover):
    path = write_hdf5(tmp_path / "log.h5", make_content(3))
    path.write_bytes(changed(path.read_bytes()))
    with pytest.raises(LogError):
        tracker.open_log(path, recover=recover)


@pytest.mark.parametrize("name", [*NATIVE, *SAMPLES])
def test_recorded_samples_are_read(real: Path, name):
    posed, native = "with_pose" in name, name in NATIVE
    with tracker.open_log(real / "logs" / name) as log:
        frames = list(log)
        assert len(frames) == len(log) == 3 + native
        assert log.camera_names == CAMERAS
        if not native:
            assert log.rig.names == CAMERAS
            assert (log.rig[0].width, log.rig[0].height) == log.image_sizes[0] == (540, 540)
    for k, frame in enumerate(frames):
        began = 1_605_000_000 if native else 1_750_000_000
        assert frame.timestamp == pytest.approx(began + 0.1 * k, abs=1e-6)
        np.testing.assert_allclose(frame.camera_timestamps - frame.timestamp, [0, 0.001, 0.002], atol=1e-5)
        assert (frame.recorded_pose is not None) == (posed and (native or k > 0))
        assert (frame.recorded_filtered_pose is not None) == (posed and native and k > 0)
        if posed and native:
            np.testing.assert_allclose(frame.recorded_pose.position, [-0.0627, -0.1356, 0.0276])
            assert frame.recorded_pose.confidence == 0.93
    if posed and not native:
        assert [frame.recorded_pose.confidence for frame in frames[1:]] == [0.93, 0.92]
        assert np.linalg.norm(frames[1].recorded_pose.orientation) == pytest.approx(1, abs=1e-12)


def test_recorded_images_give_the_recorded_pose(real: Path):
    """So colours are the right way round, and images and calibration belong together."""
    with tracker.open_log(real / "logs" / SAMPLES[1]) as log:
        detector = tracker.ObjectTracker(tracker.load_object("cube_v2"), log.rig)
        frame = log[1]
    found, recorded = detector.detect(list(frame.images)).object_pose, frame.recorded_pose
    assert found.confidence > 0.9
    assert np.linalg.norm(found.position - recorded.position) < 3e-3
    assert 2 * np.arccos(abs(found.orientation @ recorded.orientation)) < np.radians(3)


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        (14712, 10, "images: found 1799814 bytes stored, expected blocks of 874800"),  # packing forgotten
        (2096, 0, "camera_names: found damaged names"),  # head of the heap with the names
    ],
)
def test_damage_that_the_library_does_not_survive_is_seen(real, tmp_path, offset, value, message):
    data = bytearray((real / "logs" / SAMPLES[0]).read_bytes())
    data[offset] = value
    (tmp_path / "log.h5").write_bytes(data)
    with pytest.raises(LogError, match=message):
        tracker.open_log(tmp_path / "log.h5")
