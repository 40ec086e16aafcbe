import dataclasses
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import tracker
from tests.helpers import LENSES, run_python
from tests.helpers.log_writers import CAMERAS, make_content
from tests.helpers.reading import attribute, change, datasets, frames_of, unpacking_to
from tests.helpers.recording_stubs import tiny_rig
from tests.logs.test_native import assert_same
from tracker.errors import LogError
from tracker.files.hdf5 import Disk
from tracker.logs.frame import RecordedPose
from tracker.logs.hdf5_writer import Hdf5LogWriter, write_hdf5
from tracker.logs.pictures import from_bayer, to_bayer


def write(path, content, rig, **options):
    with Hdf5LogWriter(path, rig, poses=True, **options) as writer:
        for k, row in enumerate(content.poses):
            pose = RecordedPose(row[:3], row[3:7], row[7]) if row[7] > 0 else None
            writer.append(list(content.raw[k]), content.stamps[k], content.camera_stamps[k], pose)
        assert len(writer) == len(content.raw)
    return path


@pytest.mark.parametrize("count", LENSES)
def test_what_is_written_is_read(tmp_path, count):
    rig = tracker.CameraRig(tuple(dataclasses.replace(one, distortion=LENSES[count]) for one in tiny_rig()))
    content = make_content(25)
    content.poses[5] = (40.0, -3.0, 0.03, 0.0, 0.0, 0.0, 1.0, 0.5)  # far from the world's origin
    path = write(tmp_path / "log.h5", content, rig, frame_rate=10.0)
    with tracker.open_log(path) as log:
        assert log.format == "HDF5 camera log, version 2.1, with poses"
        assert_same(log, content, poses=1)
        assert (np.array(log[7].raw) == content.raw[7]).all()
        assert log[5].recorded_pose.position.tolist() == [40.0, -3.0, 0.03]
        for one, other in zip(log.rig, rig, strict=True):
            assert one.name == other.name
            assert (one.matrix == other.matrix).all()
            assert (one.distortion == other.distortion).all()
            np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-12)
    content = path.read_bytes()
    with pytest.raises(LogError, match="there is such a file"):
        Hdf5LogWriter(path, rig)
    assert path.read_bytes() == content
    with pytest.raises(LogError, match="cannot be written"):
        Hdf5LogWriter(tmp_path / "no" / "log.h5", rig)
    for wrong, message in [
        ({"rig": tracker.CameraRig((rig[0], rig[1].resized(56, 48)))}, "cameras of 28×24, 56×48 px, exp"),
        ({"frame_rate": "10"}, "frame_rate: found '10', expected above 0 Hz"),
        ({"frame_rate": 0.0}, "frame_rate: found 0.0"),
        ({"settings": [{}]}, f"settings: found 1, expected {len(rig)}"),
        ({"settings": {"camera60": {}}}, "settings: found a mapping of 1"),
        *[
            ({"settings": [{"Gain": one}] * 3}, "expected texts and numbers by name")
            for one in (None, [1], 10**400)
        ],
    ]:
        with pytest.raises(LogError, match=message):
            Hdf5LogWriter(tmp_path / "wrong.h5", **{"rig": rig, **wrong})
        assert not (tmp_path / "wrong.h5").exists()


def test_the_layout_is_that_of_the_platform_s_writer(tmp_path):
    path = write(tmp_path / "log.h5", make_content(3), tiny_rig(), frame_rate=10.0)
    with h5py.File(path) as file:
        attributes = {name: int(value) for name, value in file.attrs.items()}
        assert attributes == {
            **{"magic": 0x3CDA7A00, "format_version": 2, "format_version_minor": 1},
            **{"num_cameras": 3, "image_width": 28, "image_height": 24},
        }
        fields = [(name, one.shape, one.dtype.str) for name, one in file.items() if hasattr(one, "shape")]
        images, stamps = ("images", (3, 3, 24, 28), "|u1"), ("timestamps", (3, 3), "<f8")
        states, names = ("sensor_data_timestamps", (3,), "<f8"), ("camera_names", (3,), "|S9")
        assert sorted(fields) == [names, images, states, stamps]
        group = file["camera_info/camera60"]
        assert {name: field.shape for name, field in group.items()} == {
            **{"camera_matrix": (3, 3), "distortion_coefficients": (1, 5), "tf_world_to_camera": (4, 4)},
            "tf_world_to_camera_std": (4, 4),  # the platform's writer leaves it out
        }
        assert group.attrs["frame_rate_fps"] == 10


@pytest.mark.parametrize("table", [0.002, None])
def test_the_deviations_and_the_arena_come_back(tmp_path, table):
    deviations = np.full((4, 4), 1e-3)
    cameras = [dataclasses.replace(one, camera_from_world_std=deviations) for one in tiny_rig()]
    arena = tracker.Arena((10.0, -3.0), 0.3, 0.2, table, (0.001, 0.002))
    path = write(tmp_path / "log.h5", make_content(1), tracker.CameraRig(cameras, arena))
    with tracker.open_log(path) as log:
        assert log.rig.arena == arena
        for camera in log.rig:
            np.testing.assert_array_equal(camera.camera_from_world_std, deviations)
    for text, message in (
        ('{"radius": -1}', r"arena: radius: found -1\.0, exp"),
        ("[1]", "arena: .* must be a mapping"),
    ):
        change(path, attribute("arena", np.bytes_(text)))
        with tracker.open_log(path) as log, pytest.raises(LogError, match=message):
            assert log.rig


def test_a_colour_image_keeps_what_the_mosaic_measures(rng, tmp_path):
    image = rng.integers(0, 256, (24, 28, 3), np.uint8)
    even = np.broadcast_to(rng.integers(0, 256, 3, np.uint8), image.shape)
    assert (from_bayer(to_bayer(even)) == even).all()
    with Hdf5LogWriter(tmp_path / "log.h5", tiny_rig()) as writer:
        writer.append([image, None, even], 3.5)
    (frame,) = frames_of(tmp_path / "log.h5")
    assert (frame.raw[0] == to_bayer(image)).all()
    assert not frame.images[1].any()
    assert (frame.images[2] == even).all()
    assert frame.timestamp == 3.5
    assert frame.camera_timestamps.tolist() == [3.5] * 3
    assert frame.recorded_pose is None


def test_frames_left_out_may_take_longer_than_two_frames_may_be_apart(tmp_path):
    with Hdf5LogWriter(tmp_path / "log.h5", tiny_rig()) as writer:
        for k in range(3):
            writer.append(make_content(1).images(0), 3000.0 * k)
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert [frame.timestamp for frame in log[::2]] == [0.0, 6000.0]


@pytest.mark.parametrize("ahead", [-0.15, 0.0, 0.15])
@pytest.mark.parametrize("missing", [np.nan, 0.2])
def test_a_camera_that_lags_or_leads_and_misses_an_image_goes_on(ahead, missing, tmp_path):
    image = np.full((24, 28, 3), 90, np.uint8)
    with Hdf5LogWriter(tmp_path / "log.h5", tiny_rig()) as writer:
        for k in range(4):
            there = k != 2
            stamps = [0.1 * k, 0.1 * k, 0.1 * k + ahead if there else missing]
            writer.append([image, image, image if there else None], 0.1 * k, stamps)
    with tracker.open_log(tmp_path / "log.h5") as log:
        write_hdf5(tmp_path / "copy.h5", log, log.rig, lambda count: None)
    for name in ("log.h5", "copy.h5"):
        frames = frames_of(tmp_path / name)
        found = [frame.camera_timestamps[2] for frame in frames]
        assert found == pytest.approx([ahead, 0.1 + ahead, np.nan, 0.3 + ahead], nan_ok=True)
        for images in (frame.images for frame in frames), (frame.raw for frame in frames):
            assert [three[2] is None for three in images] == [False, False, True, False]


def test_an_image_that_is_missing_after_a_driver_error_is_read_as_missing(tmp_path):
    images = make_content(1).images(0)
    with Hdf5LogWriter(tmp_path / "log.h5", tiny_rig()) as writer:
        writer.append(images, 1.0)
        writer.append([None] * 3, 1.1, [np.nan] * 3)
        writer.append([None, *images[1:]], 1.2)
    error, last = frames_of(tmp_path / "log.h5")[1:]
    assert error.images == (None,) * 3
    assert [image is None for image in last.images] == [True, False, False]


ENDINGS = """
import os, resource, signal, sys
from tests.helpers.log_writers import make_content
from tests.helpers.recording_stubs import tiny_rig
from tracker.errors import LogError
from tracker.logs import hdf5_writer
from tracker.logs.hdf5_writer import Disk, Hdf5LogWriter

os.chdir(sys.argv[1])
content = make_content(25)

def fill(writer):
    for raw, stamp in zip(content.raw, content.stamps):
        writer.append(list(raw), stamp)

for size in (0, 3000, 40_000, 50_000, 60_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, -1))  # no file may be longer
    writer = ()
    try:
        with Hdf5LogWriter(f"{size}.h5", tiny_rig(), flush_every=5, name="there.h5") as writer:
            fill(writer)
    except LogError as error:
        print(size, len(writer), error, flush=True)
resource.setrlimit(resource.RLIMIT_FSIZE, (-1, -1))

class Asked(Disk):
    def write(self, data):
        if len(writer) == 3:
            os.kill(os.getpid(), number)
        return super().write(data)

hdf5_writer.Disk = Asked
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.default_int_handler)
    writer = ()
    try:
        with Hdf5LogWriter(f"{number.name}.h5", tiny_rig(), flush_every=1) as writer:
            fill(writer)
    except KeyboardInterrupt:
        print(number.name, len(writer), flush=True)

hdf5_writer.Disk = Disk
fill(Hdf5LogWriter("killed.h5", tiny_rig(), flush_every=10))
os._exit(1)
"""


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """A folder of logs that ended early, in a process that the library may end, and what it printed."""
    folder = tmp_path_factory.mktemp("ended")
    result = run_python(["-c", ENDINGS, folder])
    assert (result.returncode, result.stderr) == (1, "")
    return folder, dict(line.split(" ", 1) for line in result.stdout.splitlines())


def test_what_was_flushed_survives_the_process(ended):
    content, frames = make_content(25), frames_of(ended[0] / "killed.h5", recover=True)
    assert len(frames) >= 20
    for frame in frames[:20]:
        assert (np.array(frame.raw) == content.raw[frame.index]).all()


def test_whatever_write_is_the_last_all_that_was_flushed_is_read(tmp_path, monkeypatch):
    path, content, states, flushed = tmp_path / "log.h5", make_content(4), [], [0]

    class Watched(Disk):
        def write(self, data):
            size = super().write(data)
            states.append((flushed[-1], path.read_bytes()))
            return size

    monkeypatch.setattr("tracker.logs.hdf5_writer.Disk", Watched)
    with Hdf5LogWriter(path, tiny_rig(), flush_every=1) as writer:
        for raw, stamp in zip(content.raw, content.stamps, strict=True):
            writer.append(list(raw), stamp)
            flushed.append(len(writer))
    for count, state in states:
        if count:
            (tmp_path / "killed.h5").write_bytes(state)
            frames = frames_of(tmp_path / "killed.h5")
            assert len(frames) >= count
            assert all((np.array(frame.raw) == content.raw[frame.index]).all() for frame in frames)


def test_what_does_not_fit_is_refused_and_changes_nothing(tmp_path):
    content = make_content(2)
    images = list(content.raw[0])
    with Hdf5LogWriter(tmp_path / "log.h5", tiny_rig()) as writer:
        writer.append(images, 1.0)
        for given, stamp, stamps, message in [
            (images[:2], 2.0, None, "2 images, expected 3"),
            (dict(zip(CAMERAS, images, strict=True)), 2.0, None, "images: found a mapping of 3, expected"),
            ([images[0].tolist(), *images[1:]], 2.0, None, "camera60: found a list of 24, expected uint8"),
            ([images[0][1:], *images[1:]], 2.0, None, "camera60: found uint8 of shape"),
            ([images[0].astype(float), *images[1:]], 2.0, None, "float64"),
            (images, -1e9, None, "stamp -1e.09 s, expected at least -3600 s"),
            (images, "2.0", None, "stamp: found '2.0', expected finite numbers of seconds"),
            (images, 1_700_000_000_000_000_000, None, "is it in nanoseconds"),
            (images, 2.0, ["1.0", "2.0", "2.0"], "camera_timestamps: found .*, expected finite numbers"),
            (images, 2.0, [2.0, 2.0, 2e18], "is it in nanoseconds"),
            (images, 2.0, [1.0, 2.0], "stamps of shape"),
            (images, 0.5, None, "the frame's stamp goes back by 0.5 s since frame 0"),
            (images, 2.0, [2.0, 2.0, 0.9], "the stamp of camera number 3 goes back by 0.1 s"),
            (images, 1.8e9, None, r"stamp goes forward by 1.8e\+09 s since frame 0, expected 0 to 3600 s"),
        ]:
            place = rf"^{tmp_path}/log\.h5: frame 1: "
            with pytest.raises(LogError, match=f"{place}.*{message}"):
                writer.append(given, stamp, stamps)
        writer.append(images, 2.0, [2.0, float("nan"), 2.5])
    with pytest.raises(LogError, match="frame 2: the recording is closed"):
        writer.append(images, 3.0)
    writer.flush()
    with Hdf5LogWriter(tmp_path / "poses.h5", tiny_rig(), poses=True) as writer:
        with pytest.raises(LogError, match="frame 0: pose: found 3, expected one with position, orient"):
            writer.append(images, 1.0, pose=3)
        pose = {"position": (0.1, 0.0, 0.03), "orientation": (0.0, 0.0, 0.0, 1.0), "confidence": 0.5}
        for change, message in [
            ({"position": 0.1}, r"pose: position: found shape \(\), expected numbers of shape \(3,\)"),
            ({"position": (np.inf, 0.0, 0.0)}, r"pose: found the position \(inf, 0, 0\) m"),
            ({"orientation": (0.0, 0.0, 0.0, 2.0)}, "pose: found a quaternion of length 2"),
            ({"confidence": None}, "pose: confidence: found None"),
            ({"confidence": 3.0}, "pose: found the confidence 3"),
        ]:
            with pytest.raises(LogError, match=message):
                writer.append(images, 9.0, pose=SimpleNamespace(**pose | change))
        writer.append(images, 1.0)  # what was refused is not remembered
        assert len(writer) == 1
        writer.append([0 * image for image in images], 2.0, [np.nan] * 3)
    with tracker.open_log(tmp_path / "poses.h5") as log:  # black images, but images: no driver error
        assert log[1].camera_timestamps.tolist() == [2.0] * 3
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert [frame.timestamp for frame in log] == [1.0, 2.0]
        assert log[1].camera_timestamps.tolist() == [2.0, 2.0, 2.5]
        assert log.camera_names == CAMERAS


def test_a_converted_log_keeps_the_cameras_settings(tmp_path):
    settings = [{"Gain": np.float32(1.5), "Gamma": np.nan}, {}, {"ExposureAuto": "Off"}]
    path = write(tmp_path / "log.h5", make_content(2), tiny_rig(), settings=settings)
    with tracker.open_log(path) as log:
        write_hdf5(tmp_path / "copy.h5", log, log.rig, lambda count: None)
    with tracker.open_log(tmp_path / "copy.h5") as log:
        assert log.settings == {"camera60": {"Gain": 1.5}, "camera300": settings[2]}
    change(path, unpacking_to("camera_info/camera60/settings"))
    with tracker.open_log(path) as log, pytest.raises(LogError, match=r"settings: .*unpacks to"):
        assert log.settings


def test_all_that_a_log_of_the_platform_has_is_there_in_its_type_and_shape(real, tmp_path):
    recorded = real / "logs" / "tricamera_log_with_pose.h5"
    with tracker.open_log(recorded) as log, Hdf5LogWriter(tmp_path / "log.h5", log.rig, poses=True) as writer:
        for frame in log:
            writer.append(frame.raw, frame.timestamp, frame.camera_timestamps, frame.recorded_pose)
    with h5py.File(tmp_path / "log.h5") as ours, h5py.File(recorded) as theirs:
        assert {**ours.attrs} == {**theirs.attrs}
        compared = datasets(theirs)
        for name, item in compared.items():
            assert (ours[name].shape, ours[name].compression) == (item.shape, item.compression), name
            if name == "camera_names":  # there of variable length
                assert [bytes(text) for text in ours[name]] == [bytes(text) for text in item]
            else:
                assert ours[name].dtype == item.dtype, name
                mended = 1e-4 if name.endswith("tf_world_to_camera") else 1e-6  # means of rotations
                np.testing.assert_allclose(ours[name][()], item[()], atol=mended, err_msg=name)
    assert len(compared) == 4 + 3 * 3 + 4


def test_a_full_disk_is_reported_and_what_was_flushed_before_stays(ended):
    folder, printed = ended
    flushed = []
    for size in ("0", "3000", "40000", "50000", "60000"):
        written, answer = printed[size].split(" ", 1)
        assert answer == "there.h5: cannot be written: File too large"
        flushed.append(int(written) - int(written) % 5)
        if flushed[-1]:
            frames = frames_of(folder / f"{size}.h5", recover=True)
            assert [frame.index for frame in frames] == list(range(flushed[-1]))
    assert flushed[:2] == [0, 0]
    assert flushed[-1] >= 10


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_an_interrupt_waits_until_a_frame_is_written(number, ended):
    folder, printed = ended
    assert printed[number] == "4"
    assert len(frames_of(folder / f"{number}.h5")) == 4
