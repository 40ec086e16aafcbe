import gzip
import itertools
import json
import struct
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers.log_writers import (
    POSE,
    START,
    Content,
    make_content,
    native_bytes,
    write_hdf5,
    write_native,
)
from tests.helpers.reading import frames_of, recovered
from tests.helpers.recording_stubs import tiny_rig, write_log
from tracker.errors import LogError
from tracker.logs import Log, folder, hdf5_writer
from tracker.logs.log import picked
from tracker.recordings import track

SAMPLES = ("camera_data_images_only.dat", "camera_data_with_pose.dat", "camera_data_with_pose_gzipped.dat")
VARIANTS = [
    {"poses": poses, "stamped": stamped, "timed": timed, "bgr": bgr}
    for poses, stamped, timed, bgr in itertools.product((0, 1, 2), *[(True, False)] * 3)
    if poses or not timed
]


def assert_same(log: Log, content, *, poses: int, stamped: bool = True) -> None:
    frames = list(log)
    assert [frame.index for frame in frames] == list(range(len(content.raw)))
    for k, frame in enumerate(frames):
        expected = content.stamps[k] if stamped else content.camera_stamps[k].mean()
        assert frame.timestamp == pytest.approx(expected, abs=1e-6)
        np.testing.assert_array_equal(frame.camera_timestamps, content.camera_stamps[k])
        np.testing.assert_array_equal(frame.images, content.images(k))
        for which, pose in enumerate([frame.recorded_pose, frame.recorded_filtered_pose]):
            row = content.poses[max(0, k - which)]
            assert (pose is not None) == (which < poses and row[7] > 0)
            if pose is not None:
                np.testing.assert_allclose([*pose.position, *pose.orientation, pose.confidence], row)


@pytest.mark.parametrize("convert", [None, hdf5_writer.write_hdf5, folder.write_folder])
def test_clocks_may_begin_before_their_zero(tmp_path, convert):
    content = make_content(4)
    for stamps in (content.stamps, content.camera_stamps):
        stamps -= START + 0.25
    path = write_native(tmp_path / "log", content)
    if convert is not None:
        with tracker.open_log(path) as log:
            convert(path := tmp_path / "converted", log, tiny_rig(), lambda count: None)
    for k, frame in enumerate(frames_of(path)):
        np.testing.assert_allclose(frame.camera_timestamps, content.camera_stamps[k], atol=1e-9)
        assert frame.timestamp == pytest.approx(content.stamps[k], abs=2e-3)
        np.testing.assert_array_equal(frame.images, content.images(k))
    assert k == 3


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: "-".join(str(x) for x in v.values()))
def test_every_variant_is_recognised_by_its_records(tmp_path, variant, count, packed):
    content = make_content(count)
    for stamps in (content.stamps, content.camera_stamps):
        stamps[2:3] = stamps[1:2]  # equal ones are allowed
    content.raw[3:] = 0  # as are black images
    path = write_native(tmp_path / "camera_data.dat", content, packed=packed, **variant)
    with tracker.open_log(path) as log:
        assert len(log) == count
        assert log.image_sizes == ((28, 24),) * 3
        assert log.random_access is not packed
        assert_same(log, content, poses=variant["poses"], stamped=variant["stamped"])
        assert log.fault is None


@pytest.mark.parametrize("packed", [False, True])
def test_frames_and_parts_are_those_of_the_whole(tmp_path, packed):
    content = make_content(9)
    path = write_native(tmp_path / "log", content, packed=packed, poses=1)
    with tracker.open_log(path) as log:
        assert [frame.index for frame in log[5:2]] == []
        part = log[2:8][1:]
        assert len(part) == 5
        for _ in range(2):
            assert [frame.index for frame in part] == [3, 4, 5, 6, 7]
        assert [frame.index for frame in log[::4]] == [0, 4, 8]
        for k in (7, 0, -1, 3):
            np.testing.assert_array_equal(log[k].images, content.images(k % 9))
        with pytest.raises(IndexError):
            log.frame(9)
        with pytest.raises(LogError, match="step"):
            log[::-1]
    with pytest.raises(LogError, match="closed"):
        log.frame(0)


@pytest.mark.parametrize("bgr", [False, True])
def test_pixels_of_a_frame_are_its_own(tmp_path, bgr):
    content = make_content(3)
    with tracker.open_log(write_native(tmp_path / "camera_data.dat", content, bgr=bgr)) as log:
        frames = list(log)
        for pixels in (*frames[1].images, *(frames[1].raw or ())):
            pixels[:] = 0
        for k, frame in ((0, frames[0]), (1, log.frame(1)), (2, frames[2])):
            np.testing.assert_array_equal(frame.images, content.images(k))
            assert (frame.raw is None) == bgr
            np.testing.assert_array_equal(frame.raw or content.raw[k], content.raw[k])


SECOND = 12 + 8 + 3 * (13 + 24 * 28 + 8)  # offset of record 1, of a log without poses


@pytest.mark.parametrize(
    ("offset", "new", "frames", "message"),
    [
        (0, struct.pack("<I", 2), 0, "version 2, expected 1"),
        (4, struct.pack("<Q", 5), 4, "expected 5 records"),
        (4, struct.pack("<Q", 3), 3, "expected 3 records"),
        (4, struct.pack("<Q", 2**60), 4, "expected 1152921504606846976 records"),
        (4, struct.pack("<Q", 0), 0, "0 records"),
        (20, struct.pack("<i", 2**30), 0, "expected a camera log"),
        (20, struct.pack("<i", 4000), 0, "end of the file|expected 8 to 4096"),
        (SECOND + 8, struct.pack("<i", 25), 3, "frame 1, camera number 1: found 28×25 px"),
        (SECOND + 16, struct.pack("<i", 5), 3, "frame 1, camera number 1: .*type 5"),
        (SECOND, struct.pack("<d", np.nan), 3, "frame 1: stamp: found nan"),
        (SECOND, struct.pack("<d", 1_604_999_999e3), 3, "frame 1: the frame's stamp goes back by 1 s"),
        (SECOND, struct.pack("<d", 1000 * 1_605_009_999.0), 3, "goes forward by 9999 s since frame 0"),
    ],
)
def test_damage_is_named_and_whole_records_recovered(tmp_path, offset, new, frames, message):
    path, data = tmp_path / "log", bytearray(native_bytes(make_content(4)))
    data[offset : offset + len(new)] = new
    path.write_bytes(data)
    if frames:
        assert len(recovered(path, message)[1]) == frames
    for recover in (False, True) if not frames else ():
        with pytest.raises(LogError, match=message):
            tracker.open_log(path, recover=recover)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("damaged", [0, 1, 3])
def test_the_frame_whose_stamp_is_damaged_is_left_out_not_those_after_it(tmp_path, damaged, packed):
    content = make_content(6)
    content.stamps[damaged] += 600
    path = write_native(tmp_path / "log", content, packed=packed)
    message = f"frame {damaged + 1}: the frame's stamp goes back by 59.* s since frame {damaged}"
    before, after = recovered(path, message)
    assert before == list(range(damaged + 1))
    assert after == [k for k in range(6) if k != damaged]
    with tracker.open_log(path, recover=True) as log:
        assert [frame.index for frame in picked(log, (2, 5))] == [2, 5]
        assert [frame.index for frame in picked(log[1:], (1, 4))] == [2, 5]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((0, 0, 0, np.inf, 0, 0, 1, 0.5), "quaternion of length inf"),
        ((0, 0, 0, 0.6, 0, 0, 1, 0.5), "quaternion of length 1.166"),
        ((0, np.inf, 0, 0, 0, 0, 1, 0.5), "position"),
        ((0, 0, 99e3, 0, 0, 0, 1, 0.5), "position"),
        ((0, 0, 0, 0, 0, 0, 1, 1e200), "confidence"),
        ((0, 0, 0, 0, 0, 0, 0, 0.5), None),
        ((0, 0, 0, np.nan, np.nan, np.nan, 1, 0.5), None),
        ((0, 0, 0, 0, 0, 0, 1, np.nan), None),
        ((5, 5, 5, 5, 5, 5, 5, 0), None),
    ],
)
def test_a_recorded_pose_is_one_of_length_1_or_none_or_an_error(tmp_path, row, message):
    content = make_content(3)
    content.poses[1] = row
    content.poses[2, 3:7] *= 1.001
    path = write_native(tmp_path / "log", content, poses=1)
    if message is not None:
        assert recovered(path, f"frame 1, pose: .*{message}") == ([0], [0, 2])
        return
    poses = [frame.recorded_pose for frame in frames_of(path)]
    assert poses[:2] == [None, None]
    np.testing.assert_allclose(poses[2].orientation, POSE[3:7], atol=1e-12)


def test_a_damaged_number_of_records_is_not_believed(tmp_path):
    data = bytearray(native_bytes(make_content(3)))
    struct.pack_into("<Q", data, 4, 2**63 + 3)
    (tmp_path / "log").write_bytes(data)
    with tracker.open_log(tmp_path / "log", recover=True) as log:
        assert (len(log), log.missing) == (3, 10_000_000 - 3)


@pytest.mark.parametrize("cut", [1, 9, 700, 5000])
def test_a_truncated_log_gives_the_frames_before(tmp_path, cut):
    data = native_bytes(make_content(5), poses=2)
    plain, packed = tmp_path / "plain", tmp_path / "packed"
    plain.write_bytes(data[:-cut])
    record = (len(data) - 12) // 5
    before, after = recovered(plain, "expected 5 records")
    assert (len(before), len(after)) == (0, 5 - -(-cut // record))
    packed.write_bytes(gzip.compress(data, 1)[:-cut])
    before, after = recovered(packed, "damaged or truncated")
    assert before == after
    with tracker.open_log(packed, recover=True) as log:
        assert len([*log]) == len(after)
        assert "more of this recording" not in log.fault  # it is unpacked once


def test_a_checksum_that_disagrees_and_bytes_after_the_end_are_reported_at_the_end(tmp_path):
    data = bytearray(gzip.compress(native_bytes(make_content(3)), 1))
    data[-8] ^= 1
    more = gzip.compress(native_bytes(make_content(3)) + b"x")
    for content, message in ((data, "CRC"), (more, "bytes after frame 2")):
        (tmp_path / "log").write_bytes(content)
        assert recovered(tmp_path / "log", message) == ([0, 1, 2],) * 2


@pytest.mark.parametrize("data", [b"", b"\0" * 7, b"hello", b"\x1f\x8b", b"GIF89a" * 99, bytes(9999)])
def test_what_is_no_log_or_not_there_is_refused(tmp_path, data):
    (tmp_path / "log").write_bytes(data)
    for path in (tmp_path / "log", tmp_path / "none", tmp_path, "/dev/null", "a\0b"):
        for recover in (False, True):
            with pytest.raises(LogError):
                tracker.open_log(path, recover=recover)


@pytest.mark.parametrize("name", SAMPLES)
def test_recorded_colours_are_the_right_way_round(real: Path, name):
    with (
        tracker.open_log(real / "pose" / "cube_v2") as reference,
        tracker.open_log(real / "logs" / name) as log,
    ):
        expected, images = reference[0].images, log[0].images
    for image, larger in zip(images, expected, strict=True):
        smaller = cv2.resize(larger, (270, 270), interpolation=cv2.INTER_AREA).astype(int)
        colored = np.ptp(smaller, axis=2) > 60
        difference = np.abs(image.astype(int) - smaller)[colored]
        swapped = np.abs(image[:, :, ::-1].astype(int) - smaller)[colored]
        assert np.mean(difference) < 0.5 * np.mean(swapped)


def with_errors(frames: list[int], count: int = 8) -> Content:
    content = make_content(count)
    for values in (content.raw, content.stamps, content.camera_stamps):
        values[frames] = 0
    return content


@pytest.mark.parametrize("write", [write_native, write_hdf5])
@pytest.mark.parametrize("frames", [[3], [3, 4], [0], [0, 1], [7], [6, 7], [0, 4, 7], list(range(8))])
def test_an_empty_record_is_a_frame_without_images(write, frames, tmp_path):
    content = with_errors(frames)
    with tracker.open_log(write(tmp_path / "log", content)) as log:
        read = list(log)
        alone = log[frames[0]]
        hdf5_writer.write_hdf5(tmp_path / "copy.h5", log, tiny_rig(), lambda count: None)
    with tracker.open_log(tmp_path / "copy.h5") as log:
        for frame, copy in zip(read, log, strict=True):
            assert copy.timestamp == pytest.approx(frame.timestamp, abs=1e-6)
            np.testing.assert_array_equal(copy.camera_timestamps, frame.camera_timestamps)
            assert [one is None for one in copy.images] == [one is None for one in frame.images]
    assert [frame.index for frame in read] == list(range(8))
    for frame in read:
        if frame.index in frames:
            assert frame.images == (None,) * 3
            assert np.isnan(frame.camera_timestamps).all()
            assert frame.recorded_pose is None
        else:
            assert frame.timestamp == pytest.approx(content.stamps[frame.index], abs=1e-6)
            np.testing.assert_array_equal(frame.images, content.images(frame.index))
    assert (np.diff([frame.timestamp for frame in read]) > 0).all()
    assert np.isnan(alone.timestamp)


@pytest.mark.parametrize("write", [write_native, write_hdf5, partial(write_hdf5, version=(2, 0))])
@pytest.mark.parametrize("frames", [[0, 1], [3], [7]])
def test_an_empty_record_may_hold_what_was_in_its_memory_before(write, frames, tmp_path):
    content, clock = make_content(8), make_content(8)
    content.camera_stamps[frames] = 0
    for values in (clock.stamps, clock.camera_stamps):  # a clock that begins at 0 leaves no frame out
        values -= values[0].copy()
    for given, empty in ((content, frames), (clock, [])):
        read = frames_of(write(tmp_path / "log", given))
        assert len(read) == 8
        assert (np.diff([frame.timestamp for frame in read]) > 0).all()
        assert [frame.index for frame in read if all(image is None for image in frame.images)] == empty


@pytest.mark.parametrize("stamped", [True, False])
def test_after_the_last_image_time_goes_on(stamped, tmp_path):
    content = with_errors([5, 6, 7])
    usual = content.stamps[4] - content.stamps[3]
    expected = content.stamps[4] + usual * np.arange(1, 4)
    if stamped:
        expected = content.stamps[5:] = expected + 0.01
    found = [frame.timestamp for frame in frames_of(write_hdf5(tmp_path / "log", content))]
    assert found[5:] == pytest.approx(expected, abs=1e-6)


def test_a_recording_with_an_empty_record_is_tracked_on(tmp_path, run_here):
    log = write_log(tmp_path / "log", 8)
    write_native(log, with_errors([3, 4]), poses=1)
    assert track(log, "cube_v2").poses.index.tolist() == list(range(8))
    found = json.loads(run_here("info", log, "--json").stdout)
    assert found["without_image"] == {"camera60": 2, "camera180": 2, "camera300": 2}
    result = run_here("detect", log, "--object", "cube_v2", "--frame", 3)
    assert "found frame 3 without images, expected another --frame" in result.stderr
