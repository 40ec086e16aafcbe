import contextlib
import itertools
import threading
import time

import cv2
import numpy as np
import pytest

from tracker.errors import LiveError
from tracker.live import drivers
from tracker.live.cameras import CameraEnded, CameraLost, CameraSet, CameraUnfit, Grabbed, GrabFailed
from tracker.logs.pictures import from_bayer

SIZE = (6, 4)
IMAGE = np.full((4, 6, 3), 9, np.uint8)


class Scripted:
    """A camera that does one thing after another: gives an image, raises, or calls what waits."""

    triggered = True

    def __init__(self, *acts, then=IMAGE):
        self.acts, self.then, self.opened, self.closed = list(acts), then, 0, 0

    def open(self):
        self.opened += 1
        return self

    def grab(self, timeout):
        act = self.acts.pop(0) if self.acts else self.then
        if callable(act):
            act = act()
        if isinstance(act, Exception):
            raise act
        return Grabbed(act, time.time())

    def settings(self):
        return {"Gain": float(self.opened)}

    def close(self):
        self.closed += 1


def set_of(*cameras, rate=10.0, sizes=None):
    return CameraSet([camera.open for camera in cameras], sizes or [SIZE] * len(cameras), rate=rate)


def shots(cameras, count):
    """The next sets after all cameras have been opened."""
    given = []
    deadline = time.monotonic() + 120
    while len(given) < count:
        assert time.monotonic() < deadline
        shot = cameras.next(0.5)
        if shot is not None and (given or all(fault != "not opened yet" for fault in shot.faults)):
            given.append(shot)
    return given


def refusing(error):
    def refuse():
        raise error

    return refuse


def first(count, *cameras, **more):
    """The first sets of cameras, which are closed then."""
    with contextlib.closing(set_of(*cameras, **more)) as whole:
        return shots(whole, count)


def test_a_set_has_a_picture_of_each_camera():
    one, two = Scripted(then=IMAGE), Scripted(then=IMAGE + 1)
    given = first(3, one, two)
    for shot in given[1:]:
        assert [int(image[0, 0, 0]) for image in shot.images] == [9, 10]
        assert shot.faults == (None, None)
        assert max(abs(shot.timestamp - stamp) for stamp in shot.stamps) < 1
    stamps = [shot.timestamp for shot in given]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    assert (one.opened, one.closed) == (1, 1)


def test_a_picture_that_fails_is_missing_in_its_set_only():
    bad = Scripted(IMAGE, GrabFailed("buffer torn"), IMAGE)
    given = first(8, Scripted(), bad)
    missing = [shot for shot in given if shot.images[1] is None]
    assert [shot.faults for shot in missing] == [(None, "buffer torn")]
    assert all(shot.images[0] is not None for shot in given)
    assert bad.opened == 1


def test_a_camera_that_is_lost_is_opened_again(monkeypatch):
    monkeypatch.setattr("tracker.live.cameras.LOOK_AGAIN", 0.03)
    lost = Scripted(IMAGE, CameraLost("unplugged"))
    tries = []

    def open_again():
        tries.append(1)
        if 2 <= len(tries) <= 3:
            raise LiveError("not there")
        return lost.open()

    cameras = CameraSet([Scripted().open, open_again], [SIZE] * 2, rate=10.0)
    faults, given = set(), []
    deadline = time.monotonic() + 120
    while not (given and given[-1].images[1] is not None and "not there" in faults):
        assert time.monotonic() < deadline
        shot = cameras.next(0.5)
        if shot is not None:
            given.append(shot)
            faults.add(shot.faults[1])
    cameras.close()
    assert len(tries) == 4
    assert lost.closed == 2
    assert all(shot.images[0] is not None for shot in given[2:])


def test_a_camera_that_cannot_be_used_as_it_is_set_ends_the_source_unless_it_once_could(monkeypatch):
    monkeypatch.setattr("tracker.live.cameras.LOOK_AGAIN", 0.03)
    refuse = refusing(CameraUnfit("does not take Gain = 99"))
    cameras = CameraSet([Scripted().open, refuse], [SIZE] * 2)
    with pytest.raises(CameraUnfit, match="Gain"):
        shots(cameras, 10_000)
    cameras.close()
    deadline = time.monotonic() + 120
    openers = iter([Scripted(IMAGE, CameraLost("unplugged")).open, refuse, Scripted(then=IMAGE).open])
    cameras = CameraSet([lambda: next(openers)()], [SIZE])
    while "does not take" not in str((shot := shots(cameras, 1)[0]).faults):
        assert time.monotonic() < deadline
    while shot.images[0] is None:
        assert time.monotonic() < deadline
        shot = shots(cameras, 1)[0]
    cameras.close()


def test_cameras_of_which_none_is_there_are_an_error_that_names_them(monkeypatch):
    monkeypatch.setattr("tracker.live.cameras.OPENING", 0.3)
    absent = [refusing(LiveError(f"camera {number}: not there")) for number in range(2)]
    cameras = CameraSet(absent, [SIZE] * 2)
    with pytest.raises(LiveError, match=r"not one of 2 .*: camera 0: not there; camera 1: not there"):
        shots(cameras, 20)
    cameras.close()


def test_a_camera_that_takes_long_to_open_is_waited_for(monkeypatch):
    monkeypatch.setattr("tracker.live.cameras.OPENING", 0.1)
    slow = Scripted()

    def open_slowly():
        time.sleep(0.6)
        return slow

    cameras = CameraSet([refusing(LiveError("not there")), open_slowly], [SIZE] * 2)
    assert any(shot.images[1] is not None for shot in shots(cameras, 20))
    cameras.close()


def test_cameras_that_neither_open_nor_refuse_are_an_error_too(monkeypatch):
    monkeypatch.setattr("tracker.live.cameras.OPENING", 0.1)
    monkeypatch.setattr("tracker.live.cameras.OPENING_LONG", 0.3, raising=False)
    go_on = threading.Event()

    def hang():
        go_on.wait(30)
        raise LiveError("at last")

    cameras = CameraSet([hang], [SIZE])
    with pytest.raises(LiveError, match="not one of 1 could be opened: not opened yet"):
        shots(cameras, 20)
    go_on.set()
    cameras.close()


def test_closing_waits_once_for_all_cameras_that_hang():
    go_on = threading.Event()
    cameras = set_of(*(Scripted(then=lambda: go_on.wait(30) and IMAGE) for _ in range(4)))
    cameras.next(0.5)
    cameras.next(0.5)
    start = time.monotonic()
    cameras.close()
    assert time.monotonic() - start < 4
    go_on.set()


def test_a_camera_that_hangs_does_not_hold_up_the_others():
    go_on = threading.Event()

    def hang():
        go_on.wait(20)
        return IMAGE

    cameras = set_of(Scripted(), Scripted(IMAGE, hang))
    given = shots(cameras, 6)
    assert all(shot.images[0] is not None for shot in given)
    assert given[-1].images[1] is None
    assert given[-1].faults[1] == "no picture in time"
    go_on.set()
    again = shots(cameras, 12)
    cameras.close()
    assert again[-1].images[1] is not None


def test_sets_go_on_when_all_cameras_are_gone():
    given = first(4, *(Scripted(*[GrabFailed("dark")] * 1000) for _ in range(2)))
    for shot in given:
        assert shot.images == (None, None)
        assert set(shot.faults) <= {"dark", "no picture in time"}
    assert given[-1].timestamp > given[0].timestamp


def test_raw_pixels_are_kept_and_developed():
    raw = np.random.default_rng(2).integers(0, 256, (8, 12), np.uint8)
    shot = first(2, Scripted(then=raw), sizes=[(12, 8)])[-1]
    assert np.array_equal(shot.raw[0], raw)
    assert np.array_equal(shot.images[0], from_bayer(raw))


def test_pictures_of_twice_the_size_are_halved():
    image = np.random.default_rng(3).integers(0, 256, (8, 12, 3), np.uint8)
    shot = first(2, Scripted(then=image))[-1]
    expected = image.reshape(4, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.abs(shot.images[0] - expected).max() <= 0.5
    assert shot.raw is None


def until_the_end(cameras):
    """All sets of a source that ends."""
    given, deadline = [], time.monotonic() + 120
    while time.monotonic() < deadline:
        try:
            given.append(cameras.next(0.5))
        except CameraEnded:
            cameras.close()
            return [shot for shot in given if shot is not None]
    raise AssertionError("it goes on")


def test_a_film_that_ends_ends_the_source():
    given = until_the_end(set_of(Scripted(), Scripted(IMAGE, CameraEnded("over"))))
    assert sum(shot.images[1] is not None for shot in given) <= 1


def test_sets_come_at_their_rate_and_a_timeout_before_them():
    cameras = set_of(Scripted(), rate=2.0)
    assert cameras.next(0.3) is not None
    start = time.monotonic()
    assert cameras.next(0.05) is None
    assert time.monotonic() - start >= 0.04
    cameras.close()


def test_opencv_opens_no_file_that_a_film_names(tmp_path):
    film = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    film.write(np.zeros((48, 64, 3), np.uint8))
    film.release()
    drivers.OpenCvCamera(str(tmp_path / "a.avi")).close()
    (tmp_path / "b.avi").write_text("ffconcat version 1.0\nfile 'a.avi'\n")
    with pytest.raises(LiveError, match="found no film: it starts with b'ffconcat ver'"):
        drivers.OpenCvCamera(str(tmp_path / "b.avi"))


def test_films_are_read_by_opencv_picture_by_picture(tmp_path):
    from tracker.calibration.rig import CameraRig
    from tracker.geometry.camera import Camera
    from tracker.live.sources import open_cameras

    for name, level in (("a", 60), ("b", 160)):
        film = cv2.VideoWriter(str(tmp_path / f"{name}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
        assert film.isOpened()
        for number in range(5):
            film.write(np.full((48, 64, 3), level + 10 * number, np.uint8))
        film.release()
    matrix = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    rig = CameraRig(tuple(Camera(n, 64, 48, matrix, np.zeros(5), np.eye(4)) for n in ("a", "b")))
    cameras = open_cameras(f"opencv:{tmp_path / 'a.avi'},{tmp_path / 'b.avi'}", rig, rate=20.0)
    whole = [shot for shot in until_the_end(cameras) if all(one is not None for one in shot.images)]
    assert cameras.settings == ({}, {})  # a film has none
    levels = [[round(float(image.mean()) / 10) for image in shot.images] for shot in whole]
    assert levels
    assert [one[0] for one in levels] == sorted(one[0] for one in levels)
    assert {one[0] for one in levels} <= {6, 7, 8, 9, 10}


def test_a_camera_by_its_number_is_asked_for_pictures_of_the_calibrations_size(monkeypatch):
    asked = {}

    class Capture:
        def __init__(self, number):
            self.number = number

        def isOpened(self):
            return True

        def set(self, name, value):
            asked[self.number, name] = value

    monkeypatch.setattr(drivers.cv2, "VideoCapture", Capture)
    drivers.OpenCvCamera("2", (1280, 720))
    assert asked[2, cv2.CAP_PROP_FRAME_WIDTH] == 1280
    assert asked[2, cv2.CAP_PROP_FRAME_HEIGHT] == 720
    drivers.OpenCvCamera("rtsp://somewhere", (1280, 720))
    assert ("rtsp://somewhere", cv2.CAP_PROP_FRAME_WIDTH) not in asked


def test_what_cameras_are_set_to_is_known_once_they_are_open():
    cameras = set_of(Scripted(), Scripted())
    shots(cameras, 1)
    assert cameras.settings == ({"Gain": 1.0}, {"Gain": 1.0})
    cameras.close()
