import json
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import make_rig
from tests.helpers.log_writers import CAMERAS, write_picture
from tests.helpers.reading import frames_of, recovered
from tests.helpers.stated_sizes import encoded, of_size
from tracker.errors import CalibrationError, LogError
from tracker.logs.folder import write_folder
from tracker.logs.layout import stamps_of_names
from tracker.logs.log import picked
from tracker.logs.opening import calibration_files, fitted_to


def picture(frame: int, camera: int) -> np.ndarray:
    return np.random.default_rng([frame, camera]).integers(0, 256, (20, 30, 3), np.uint8)


def write_triplets(folder: Path, names, suffix=".png") -> Path:
    for k, name in enumerate(names):
        for c, camera in enumerate(CAMERAS):
            write_picture(folder / name / f"{camera}{suffix}", picture(k, c))
            write_picture(folder / name / f"labels_{camera}.png", picture(k, c)[:, :, 0])
    return folder


def write_streams(folder: Path, names, shift=0) -> Path:
    for c, camera in enumerate(CAMERAS):
        for k, name in enumerate(names):
            write_picture(folder / camera / f"{int(name) + c * shift:0{len(name)}d}.png", picture(k, c))
    return folder


@pytest.mark.parametrize("write", [write_triplets, write_streams])
@pytest.mark.parametrize(
    ("names", "stamps"),
    [
        (["000000", "000001", "000003"], [0.0, 0.1, 0.3]),
        (["8", "9", "10"], [0.8, 0.9, 1.0]),
        (["-2", "-1", "0"], [-0.2, -0.1, 0.0]),
        (["1605000000000000000", "1605000000100000000", "1605000000300000000"], [0, 0.1, 0.3]),
        (["1605000000000000", "1605000000100000", "1605000000300000"], [0, 0.1, 0.3]),
        (["1605000000000", "1605000000100", "1605000000300"], [0, 0.1, 0.3]),
        (["1605000000", "1605000001", "1605000003"], [0, 1, 3]),
    ],
)
def test_names_are_stamps_or_numbers(tmp_path, write, names, stamps):
    frames = frames_of(write(tmp_path, names))
    offset = 1_605_000_000 if len(names[0]) > 6 else 0
    assert [frame.timestamp - offset for frame in frames] == pytest.approx(stamps, abs=1e-6)
    for k, frame in enumerate(frames):
        assert frame.index == k
        np.testing.assert_array_equal(frame.images, [picture(k, camera) for camera in range(3)])
        np.testing.assert_allclose(frame.camera_timestamps, frame.timestamp)


def test_names_with_a_point_are_seconds(tmp_path):
    names = ["-0.2", "-0.1", "0.1", "0.15", "0.2"]
    frames = frames_of(write_triplets(tmp_path, names))
    assert [frame.timestamp for frame in frames] == pytest.approx([float(name) for name in names])
    assert stamps_of_names(["0.5", "0.75", "12.0"]) == [0.5, 0.75, 12.0]
    assert stamps_of_names(["t_1605000000.25"]) == [1_605_000_000.25]
    assert stamps_of_names(["-0.5", "0.0", "t-1.5"]) == [-0.5, 0.0, 1.5]
    assert stamps_of_names(["0.5", "3"]) is None
    assert stamps_of_names(["000001", "000002"]) is None


def test_the_rate_is_that_given(tmp_path):
    frames = frames_of(write_triplets(tmp_path, ["0", "1", "2"]), rate=50.0)
    assert [frame.timestamp for frame in frames] == pytest.approx([0, 0.02, 0.04])
    frames = frames_of(write_triplets(tmp_path / "numbered", ["b1", "a2", "c3"]))
    assert [frame.timestamp for frame in frames] == pytest.approx([0.1, 0.2, 0.3])
    names = ["first", "second", "third"]
    frames = frames_of(write_triplets(tmp_path / "named", names), rate=4.0)
    assert [frame.timestamp for frame in frames] == pytest.approx([0, 0.25, 0.5])
    for rate in (0, -1, np.nan, np.inf):
        with pytest.raises(LogError, match="rate"):
            tracker.open_log(tmp_path, rate=rate)


def test_pictures_with_stamps_of_their_own_are_put_together(tmp_path):
    names = [str(1_605_000_000_000 + 100 * k) for k in range(5)]
    write_streams(tmp_path, names, shift=3)
    (tmp_path / "camera180" / f"{int(names[2]) + 3}.png").unlink()
    frames = frames_of(tmp_path)
    assert len(frames) == 5
    assert [frame.images[1] is None for frame in frames] == [False, False, True, False, False]
    np.testing.assert_allclose(frames[1].camera_timestamps - 1_605_000_000.1, [0, 0.003, 0.006], atol=1e-6)
    assert np.isnan(frames[2].camera_timestamps[1])
    assert frames[2].timestamp == pytest.approx(1_605_000_000.2, abs=4e-3)
    np.testing.assert_array_equal(frames[4].images[2], picture(4, 2))


@pytest.mark.parametrize(
    ("inside", "path"),
    [("rec", "."), ("rec/000000", ".."), ("one", "."), ("a.zarr", "data.mdb"), ("", "a.zarr/data.mdb")],
)
def test_the_calibration_beside_is_found_from_anywhere(tmp_path, inside, path, monkeypatch):
    write_triplets(tmp_path / "rec", ["000000"])
    write_triplets(tmp_path, ["one"])  # a triplet is a frame, and a recording
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "a.zarr" / "data.mdb").touch()
    make_rig().save(tmp_path)
    monkeypatch.chdir(tmp_path / inside)
    assert calibration_files(Path(path)) == [tmp_path / f"{camera}.yml" for camera in sorted(CAMERAS)]
    if "zarr" not in inside + path:
        with tracker.open_log(path) as log:
            assert (len(log), log.rig.names) == (1, CAMERAS)
            np.testing.assert_array_equal(log[0].images, [picture(0, c) for c in range(3)])


NO_TRUTHS = ("", "[]", '{"frames": 3}', '{"frames": [{"frame": 1}]}', "[" * 99999)
NO_TRUTHS += (f'{{"frames": [{{"frame": 0, "timestamp": 1{"0" * 400}}}]}}',)
NO_PICTURES = ("camera60/a.txt", "0/other.png", "camera60.txt")


@pytest.mark.parametrize(
    ("added", "message"),
    [
        ({"1/camera60.png": np.zeros((20, 31, 3), np.uint8)}, "31×20 px, expected 30×20"),
        ({"0/camera60.jpg": picture(0, 0)}, "one image of a camera"),
        ({"01/camera60.png": picture(0, 0)}, "images called 01 and 1, expected one name of each moment"),
        *[({"ground_truth.json": text}, r"ground_truth\.json") for text in NO_TRUTHS],
        *[({place: ""}, "no images of cameras.*begin with camera") for place in NO_PICTURES],
    ],
)
def test_a_folder_that_is_no_recording_is_refused_with_the_reason(tmp_path, added, message):
    ((path, content),) = added.items()
    if not message.startswith("no images of cameras"):
        write_triplets(tmp_path, ["0", "1"])
    (tmp_path / path).parent.mkdir(exist_ok=True)
    if isinstance(content, str):
        (tmp_path / path).write_text(content)
    else:
        write_picture(tmp_path / path, content)
    with pytest.raises(LogError, match=message):
        frames_of(tmp_path)


@pytest.mark.parametrize(
    ("suffix", "damage", "message"),
    [
        (".png", lambda data: data[:-6], "truncated"),
        (".png", lambda data: data[:400] + bytes([data[400] ^ 1]) + data[401:], "checksum"),
        (".png", lambda data: data[:16] + b"\x7f" + data[17:], "head cannot be read: .*checksum"),
        (".png", lambda data: of_size("png", 4097, 8), "4097×8 px, expected 8 to 4096"),
        (".png", lambda data: encoded("png", np.uint16(picture(1, 1)) << 4), "as from a 12-bit camera; exp"),
        (".png", lambda data: b"", "0 bytes"),
        (".png", lambda data: data[:4], "found 4 bytes that start with b'.x89PNG', expected PNG or JPEG"),
        (".jpg", lambda data: data[: len(data) // 2], "without an end"),
        (".jpg", lambda data: b"GIF89a" + data[6:], "PNG or JPEG"),
    ],
)
def test_damaged_pictures_are_named_and_frames_that_are_picked_are_those_that_are_whole(
    tmp_path, suffix, damage, message
):
    write_triplets(tmp_path, ["0", "1", "2"], suffix=suffix)
    file, place = tmp_path / "1" / f"camera180{suffix}", rf"1/camera180\{suffix}: .*{message}"
    file.write_bytes(damage(file.read_bytes()))
    assert recovered(tmp_path, place) == ([0], [0, 2])
    with tracker.open_log(tmp_path, recover=True) as log:
        assert [frame.index for frame in picked(log, range(3))] == [0, 2]
    with tracker.open_log(tmp_path) as log, pytest.raises(LogError, match=place):
        list(picked(log, range(3)))


def write_truth(folder: Path, stamps: dict[str, float], sequence: bool) -> None:
    early = {"camera180": {"timestamp": -0.004}}  # the first frame's image of one camera
    frames = [{"frame": name, "timestamp": stamp} for name, stamp in stamps.items()]
    frames[0]["cameras"] = early
    truth = {"settings": {"sequence": sequence, "rate": 10.0}, "frames": frames}
    (folder / "ground_truth.json").write_text(json.dumps(truth))


@pytest.mark.parametrize(("sequence", "starts"), [(True, (0, 3)), (False, (0, 1, 2, 3))])
def test_stamps_of_synthetic_data_are_those_of_the_truth(tmp_path, sequence, starts):
    write_triplets(tmp_path, ["000000", "000001", "000002", "000003"])
    stamps = {"000000": 0.0, "000001": 0.1, "000002": 0.3, "000003": 5.0}
    write_truth(tmp_path, stamps, sequence)
    with tracker.open_log(tmp_path) as log:
        assert "synthetic" in log.format
        assert [frame.timestamp for frame in log] == pytest.approx(list(stamps.values()))
        assert [frame.camera_timestamps.tolist() for frame in log[:2]] == [[0.0, -0.004, 0.0], [0.1] * 3]
        assert log.episode_starts == starts
        with pytest.raises(CalibrationError, match=r"found no calibration .*; or one scene's folder alone"):
            fitted_to(tmp_path, log)
    del stamps["000001"]
    write_truth(tmp_path, stamps, sequence)
    assert recovered(tmp_path, "000001 is missing in ground_truth.json") == ([0], [0, 2, 3])


@pytest.mark.parametrize(
    "stamps",
    [
        # A camera is late by three frames, another one misses images, and one stamp comes twice.
        [[0, 0.3, 0.1], [0.1, 0.3, np.nan], [0.1, np.nan, 0.2], [0.2, 0.35, 0.7]],
        # No two cameras have an image of one frame.
        [[0, np.nan, np.nan], [np.nan, 0.1, np.nan], [np.nan, 0.2, np.nan], [np.nan, np.nan, 0.3]],
    ],
)
def test_a_written_folder_keeps_frames_and_stamps_as_they_are(tmp_path, stamps):
    stamps = np.array(stamps)
    for (k, c), stamp in np.ndenumerate(stamps):
        if not np.isnan(stamp):
            write_picture(tmp_path / "old" / CAMERAS[c] / f"{2 * k}.png", picture(k, c))
    lines = "".join(f"{camera} = '{camera}/*.png'\n" for camera in CAMERAS)
    (tmp_path / "old" / "recording.toml").write_text(f"[cameras]\n{lines}")
    np.savetxt(tmp_path / "old" / "stamps.csv", np.nan_to_num(stamps), delimiter=",")
    with tracker.open_log(tmp_path / "old") as log:
        write_folder(tmp_path / "new", log, make_rig(30, 20), lambda _: None)
    frames = frames_of(tmp_path / "new")
    means = np.maximum.accumulate(np.nanmean(stamps, axis=1))
    assert [frame.timestamp for frame in frames] == pytest.approx(means)
    np.testing.assert_array_equal([frame.camera_timestamps for frame in frames], stamps)
    for k, frame in enumerate(frames):
        for c, image in enumerate(frame.images):
            np.testing.assert_array_equal(image, None if np.isnan(stamps[k, c]) else picture(k, c))
