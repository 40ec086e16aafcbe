import itertools
import threading
import time
from contextlib import closing
from functools import partial
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from tests.helpers import make_rig
from tracker.calibration.rig import CameraRig
from tracker.errors import ImageError, LiveError
from tracker.live import SourceEnded, drivers
from tracker.live.cameras import CameraLost, CameraSet, CameraUnfit, Grabbed
from tracker.live.sources import open_cameras
from tracker.logs.pictures import from_bayer

IMAGE = np.full((4, 6, 3), 9, np.uint8)


class Scripted:
    """A camera that does one thing after another: gives an image, raises, or calls what waits."""

    triggered = True

    def __init__(self, *acts, then=IMAGE):
        self.acts, self.then, self.closed = list(acts), then, 0
        self.open = Mock(return_value=self)

    def grab(self, timeout):
        act = self.acts.pop(0) if self.acts else self.then
        if callable(act):
            act = act()
        if isinstance(act, Exception):
            raise act
        return act if isinstance(act, Grabbed) else Grabbed(act, time.time())

    def settings(self):
        return {"Gain": float(self.open.call_count)}

    def close(self):
        self.closed += 1


def cameras_of(*openers, rate=10.0, size=(6, 4)):
    """A source of these cameras, or of what opens them."""
    openers = [one.open if isinstance(one, Scripted) else one for one in openers]
    return CameraSet(openers, [size] * len(openers), rate=rate)


def sets(source, enough):
    """The sets of a source, once all its cameras were tried, until there are so many or `enough` says so."""
    given, done = [], enough if callable(enough) else lambda found: len(found) == enough
    while not (given and done(given)):
        one = source.next(0.5)
        if one is not None and (given or all(fault != "not opened yet" for fault in one.faults)):
            given.append(one)
    return given


def first(enough, *cameras, **more):
    """The first sets of cameras, which are closed then."""
    with closing(cameras_of(*cameras, **more)) as whole:
        return sets(whole, enough)


class Film(Scripted):
    """Gives images of grey levels 0, 1, …; at one of them it takes its time."""

    film = True

    def __init__(self, slow=-1):
        super().__init__(*(partial(self.level, k, 0.12 * (k == slow)) for k in range(40)))

    def level(self, k, seconds):
        time.sleep(seconds)
        return np.full((4, 6, 3), k, np.uint8)


def test_films_stay_in_step_when_one_is_late_and_images_that_belong_together_have_one_stamp():
    given = first(15, Film(), Film(slow=4), rate=25.0)
    levels = [[None if image is None else int(image.max()) for image in one.images] for one in given]
    assert any(None in some for some in levels)
    assert any(late is not None for _, late in levels[-8:])
    assert all(len(set(some) - {None}) == 1 for some in levels)
    for shot in given:
        pairs = zip(shot.images, shot.stamps, strict=True)
        assert len({stamp for image, stamp in pairs if image is not None}) == 1


def well_after(fault):
    """Whether the last camera gives images again, after it had a fault."""
    return lambda found: found[-1].images[-1] is not None and any(one.faults[-1] == fault for one in found)


@pytest.fixture
def times(monkeypatch):
    """Sets how long is waited for cameras [s]; a lost one is looked for soon."""

    def set_times(**seconds):
        for name, value in seconds.items():
            monkeypatch.setattr(f"tracker.live.cameras.{name}", value)

    set_times(LOOK_AGAIN=0.03)
    return set_times


def test_a_set_has_a_picture_of_each_camera():
    one, two = Scripted(then=IMAGE), Scripted(then=IMAGE + 1)
    with closing(cameras_of(one, two)) as source:
        given = sets(source, 3)
        assert source.settings == ({"Gain": 1.0}, {"Gain": 1.0})
    for shot in given[1:]:
        assert [int(image[0, 0, 0]) for image in shot.images] == [9, 10]
        assert shot.faults == (None, None)
        assert max(abs(shot.timestamp - stamp) for stamp in shot.stamps) < 1
    stamps = [shot.timestamp for shot in given]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    assert (one.open.call_count, one.closed) == (1, 1)


TORN = LiveError("buffer torn")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (TORN, "buffer torn"),
        (LiveError(), "LiveError"),
        (None, "expected uint8 (H, W, 3), or (H, W) if raw"),
        *(
            (image, f"found {image.dtype}")
            for image in (IMAGE.astype(np.uint16), IMAGE / 9, IMAGE[0, 0], IMAGE[:0], IMAGE[..., :2])
        ),
        *((Grabbed(IMAGE, stamp), "stamp: found ") for stamp in (None, float("nan"), 1.8e18)),
    ],
)
def test_a_picture_that_fails_or_has_not_eight_bits_or_no_stamp_is_missing_in_its_set_only(given, words):
    bad = Scripted(IMAGE, given, IMAGE)
    sets_given = first(5, Scripted(), bad)
    ((good, fault),) = (shot.faults for shot in sets_given if shot.images[1] is None)
    assert good is None
    assert fault == words if isinstance(given, Exception) else words in fault
    assert not isinstance(given, np.ndarray) or "expected uint8 (H, W, 3), or (H, W) if raw" in fault
    assert all(shot.images[0] is not None for shot in sets_given)
    bad.open.assert_called_once()


def test_a_camera_that_is_lost_is_opened_again(times):
    lost, absent = Scripted(IMAGE, CameraLost("unplugged")), LiveError("not there")
    opener = Mock(side_effect=[lost, absent, absent, lost])
    given = first(well_after("not there"), Scripted(), opener)
    assert opener.call_count == 4
    assert lost.closed == 2
    assert all(shot.images[0] is not None for shot in given[2:])


def test_a_camera_that_is_lost_as_soon_as_it_is_open_is_opened_no_more_often_than_a_missing_one(times):
    times(LOOK_AGAIN=0.2)
    lost, start = Scripted(then=CameraLost("no image")), time.monotonic()
    first(6, Scripted(), lost)
    assert 2 <= lost.open.call_count <= 1 + (time.monotonic() - start) / 0.2


def test_a_camera_that_is_lost_as_it_is_opened_is_closed(times):
    gone = Scripted()
    gone.settings = Mock(side_effect=[CameraLost("unplugged"), {}])
    first(2, gone)
    assert (gone.open.call_count, gone.closed) == (2, 2)


def test_a_camera_that_cannot_be_used_as_it_is_set_ends_the_source_unless_it_once_could(times):
    unfit = CameraUnfit("does not take Gain = 99")
    with pytest.raises(CameraUnfit, match="Gain"):
        first(10_000, Scripted(), Mock(side_effect=unfit))
    lost = Scripted(IMAGE, CameraLost("unplugged"))
    given = first(well_after(str(unfit)), Mock(side_effect=[lost, unfit, Scripted()]))
    assert given[-1].faults == (None,)


@pytest.mark.parametrize(
    ("names", "answered", "found"),
    [
        ("ab", True, "2 could be opened: camera a: not there; camera b: not there"),
        ("a", False, "1 .*: not opened yet"),
    ],
)
def test_cameras_of_which_none_can_be_opened_in_time_are_an_error_that_names_them(
    names, answered, found, times
):
    times(OPENING=0.1, OPENING_LONG=0.3)
    go_on = threading.Event()

    def refuse(name):
        assert answered or go_on.wait(60)
        raise LiveError(f"camera {name}: not there")

    with closing(cameras_of(*(partial(refuse, name) for name in names))) as source:
        with pytest.raises(LiveError, match=f"not one of {found}"):
            sets(source, 20)
        go_on.set()


def test_a_camera_that_takes_long_to_open_is_waited_for(times):
    times(OPENING=0.1)
    absent, slow = Mock(side_effect=LiveError("not there")), lambda: time.sleep(0.6) or Scripted()
    given = first(lambda found: found[-1].images[1] is not None, absent, slow)
    assert given[-1].faults == ("not there", None)


def test_closing_waits_once_for_all_cameras_that_hang(monkeypatch):
    monkeypatch.setattr("tracker.live.cameras._GRAB", 0.2)
    go_on = threading.Event()
    source = cameras_of(*(Scripted(then=lambda: go_on.wait(30) and IMAGE) for _ in range(8)))
    source.next(0.5)
    source.next(0.5)
    start = time.monotonic()
    source.close()
    assert time.monotonic() - start < 2.5
    go_on.set()


def test_a_camera_that_hangs_does_not_hold_up_the_others():
    go_on = threading.Event()
    hang = Scripted(IMAGE, lambda: go_on.wait(20) and IMAGE)
    with closing(cameras_of(Scripted(), hang)) as source:
        given = sets(source, 6)
        assert all(shot.images[0] is not None for shot in given)
        assert given[-1].images[1] is None
        assert given[-1].faults[1] == "no image in time"
        go_on.set()
        sets(source, lambda found: found[-1].images[1] is not None)


@pytest.mark.parametrize("rate", [10.0, 20.0])
def test_free_cameras_no_faster_than_the_sets_give_their_images(rate):
    free = Scripted(then=lambda: time.sleep(0.1) or IMAGE)
    free.triggered = False
    given = first(20, free, rate=rate)
    assert sum(shot.images[0] is not None for shot in given) >= 20 * 6 / rate


def test_a_free_camera_that_fails_is_asked_once_a_set():
    calls = []
    free = Scripted(then=lambda: calls.append(1) or TORN)
    free.triggered = False
    given = first(6, Scripted(), free)
    assert 1 < len(calls) < 5 * len(given)


def test_an_image_that_comes_after_its_set_is_not_older_than_that_set():
    free = Scripted(then=lambda: time.sleep(0.06) or IMAGE)
    free.triggered = False

    def grab(timeout, take=free.grab):
        taken = take(timeout)
        time.sleep(0.02)  # from the exposure to the arrival
        return taken

    free.grab = grab
    stamps = [shot.timestamp for shot in first(30, free, rate=20.0)]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))


def test_sets_go_on_when_all_cameras_are_gone():
    given = first(4, *(Scripted(*[LiveError("dark")] * 1000) for _ in range(2)))
    for shot in given:
        assert shot.images == (None, None)
        assert set(shot.faults) <= {"dark", "no image in time"}
    assert given[-1].timestamp > given[0].timestamp


def test_raw_pixels_are_kept_and_developed():
    raw = np.random.default_rng(2).integers(0, 256, (8, 12), np.uint8)
    shot = first(2, Scripted(then=raw), size=(12, 8))[-1]
    assert np.array_equal(shot.raw[0], raw)
    assert np.array_equal(shot.images[0], from_bayer(raw))


def test_raw_pixels_are_not_given_only_where_a_camera_with_colours_misses_its_image():
    raw = np.zeros((8, 12), np.uint8)
    given = first(3, Scripted(then=raw), Scripted(IMAGE, LiveError("dark")))
    assert [one.images[1] is None for one in given] == [False, True, False]
    assert [one.raw for one in given] == [None] * 3


def test_pictures_of_twice_the_size_are_halved():
    image = np.random.default_rng(3).integers(0, 256, (8, 12, 3), np.uint8)
    shot = first(2, Scripted(then=image))[-1]
    expected = image.reshape(4, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.abs(shot.images[0] - expected).max() <= 0.5
    assert shot.raw is None


def until_the_end(source):
    """All sets of a source that ends."""
    given = []
    with pytest.raises(SourceEnded), closing(source):
        sets(source, lambda found: given.append(found[-1]))
    return given


def test_a_film_that_ends_ends_the_source():
    given = until_the_end(cameras_of(Scripted(), Scripted(IMAGE, SourceEnded("over"))))
    assert sum(shot.images[1] is not None for shot in given) <= 1


def test_sets_come_at_their_rate_and_a_timeout_before_them():
    with closing(cameras_of(Scripted(), rate=2.0)) as source:
        assert source.next(0.3) is not None
        start = time.monotonic()
        assert source.next(0.05) is None
        assert time.monotonic() - start >= 0.04


def write_film(path, levels):
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    assert film.isOpened()
    for level in levels:
        film.write(np.full((48, 64, 3), level, np.uint8))
    film.release()
    return str(path)


def test_opencv_opens_no_file_that_a_film_names(tmp_path):
    drivers.OpenCvCamera(write_film(tmp_path / "a.avi", [0])).close()
    (tmp_path / "b.avi").write_text("ffconcat version 1.0\nfile 'a.avi'\n")
    with pytest.raises(LiveError, match="found no film: it starts with b'ffconcat ver'"):
        drivers.OpenCvCamera(str(tmp_path / "b.avi"))


def test_films_are_read_by_opencv_picture_by_picture_from_the_first_at_even_times(tmp_path):
    films = [write_film(tmp_path / f"{level}.avi", range(level, level + 50, 10)) for level in (60, 160)]
    cameras = open_cameras(f"opencv:{','.join(films)}", CameraRig(make_rig(64, 48).cameras[:2]))
    given = until_the_end(cameras)
    assert cameras.settings == ({}, {})  # a film has none
    levels = [round(float(shot.images[0].mean()) / 10) for shot in given if shot.images[0] is not None]
    assert levels[0] == 6
    assert levels == sorted(levels)
    assert set(levels) <= {6, 7, 8, 9, 10}
    assert given[1].stamps[0] - given[0].stamps[0] > 0.08


def test_films_go_to_the_cameras_that_they_are_named_after(tmp_path):
    rig = CameraRig(make_rig(64, 48).cameras[:2])
    films = [write_film(tmp_path / f"camera{name}.avi", [level]) for name, level in ((180, 90), (60, 160))]
    given = until_the_end(open_cameras(f"opencv:{','.join(films)}", rig))
    levels = [round(float(image.mean()) / 10) for image in given[0].images]
    assert (rig.names, levels) == (("camera60", "camera180"), [16, 9])
    other = write_film(tmp_path / "camera300.avi", [0])
    with pytest.raises(ImageError, match=r"camera300.avi: named after camera300; expected one for each of"):
        open_cameras(f"opencv:{films[0]},{other}", rig)


def test_a_camera_by_its_number_is_asked_for_pictures_of_the_calibrations_size(monkeypatch):
    opened = {2: Mock(), "rtsp://somewhere": Mock()}
    monkeypatch.setattr(drivers.cv2, "VideoCapture", opened.get)
    for what in ("2", "rtsp://somewhere"):
        drivers.OpenCvCamera(what, (1280, 720))
    numbered, other = (dict(call.args for call in one.set.call_args_list) for one in opened.values())
    size = {cv2.CAP_PROP_FRAME_WIDTH: 1280, cv2.CAP_PROP_FRAME_HEIGHT: 720}
    assert size.items() <= numbered.items()
    assert not size.keys() & other.keys()
