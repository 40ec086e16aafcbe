import contextlib
import time
from types import SimpleNamespace

import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.errors import LiveError, LogError
from tracker.live import Pushed, Replay, SourceEnded
from tracker.live.sources import Simulation, open_source
from tracker.logs.frame import LogFrame
from tracker.logs.log import Log


def frame(index, stamp, camera_stamps=None, images=None):
    stamps = np.array([stamp, stamp] if camera_stamps is None else camera_stamps, float)
    images = images or tuple(None if np.isnan(one) else np.zeros((2, 2, 3), np.uint8) for one in stamps)
    return LogFrame(index, stamp, stamps, images, None, None)


class Frames(Log):
    """A log of frames that are there already."""

    def __init__(self, frames, starts=(), error=None):
        self.frames, self.starts, self.error, self.closed = frames, starts, error, False

    def __iter__(self):
        yield from self.frames
        if self.error is not None:
            raise self.error

    @property
    def episode_starts(self):
        return self.starts

    def close(self):
        self.closed = True


class Clock:
    """Time that passes only during sleep."""

    now = 5000.0

    def time(self):
        return self.now

    monotonic = time

    def sleep(self, seconds):
        assert seconds >= 0
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    one = Clock()
    monkeypatch.setattr("tracker.live.sources.time", one)
    return one


def all_of(replay, clock, pause=0.0):
    """Shots, and when they came [s]."""
    result = []
    with contextlib.suppress(SourceEnded):
        while True:
            shot = replay.next(0.5)
            if shot is not None:
                result.append((shot, clock.time()))
            clock.sleep(pause)
    return result


@pytest.mark.parametrize("speed", [1.0, 50.0])
def test_frames_come_at_the_pace_of_their_stamps_or_quicker(speed, clock):
    stamps = (0.0, 0.05, 2.0, 2.05)
    replay = Replay(Frames([frame(n, 1000.0 + stamp) for n, stamp in enumerate(stamps)]), speed=speed)
    shots, came = zip(*all_of(replay, clock), strict=True)
    assert [shot.timestamp for shot in shots] == pytest.approx([5000.0 + stamp / speed for stamp in stamps])
    assert came == pytest.approx([shot.timestamp for shot in shots])
    assert [shot.age for shot in shots] == pytest.approx([0.0] * 4, abs=1e-6)
    assert [shot.fresh for shot in shots] == [True, False, False, False]


def test_frames_that_nobody_fetched_in_time_are_left_out(clock):
    replay = Replay(Frames([frame(n, 0.02 * n) for n in range(21)]))
    given = all_of(replay, clock, pause=0.109)
    assert [round((shot.timestamp - 5000.0) / 0.02) for shot, _ in given] == [0, 5, 10, 16, 20]
    assert replay.skipped == 16
    assert [shot.age for shot, _ in given[:4]] == pytest.approx([0.0, 0.009, 0.018, 0.007], abs=1e-6)


def test_frames_that_come_due_faster_than_they_can_be_read_hold_up_nobody(clock):
    class Slow(Frames):
        def __iter__(self):
            for one in super().__iter__():
                clock.sleep(0.03)
                yield one

    replay = Replay(Slow([frame(n, 0.02 * n) for n in range(100)]))
    begin = clock.time()
    for count in range(1, 11):
        assert replay.next(0.1) is not None
        assert clock.time() - begin < 0.14 * count


@pytest.mark.parametrize(
    ("stamps", "came"),
    [
        ({0: 0.0, 1: 0.1, 3: 500.0, 4: 500.1}, [0.0, 0.1, 0.2, 0.3]),  # an episode's first frame is left out
        ({0: 50.0, 1: 50.05, 2: 3.0, 3: 3.05}, [0.0, 0.05, 0.15, 0.2]),
    ],
)
def test_episodes_follow_each_other_whatever_their_stamps(stamps, came, clock):
    replay = Replay(Frames([frame(*one) for one in stamps.items()], starts=(0, 2)))
    shots, times = zip(*all_of(replay, clock), strict=True)
    assert [shot.fresh for shot in shots] == [True, False, True, False]
    assert times == pytest.approx(5000.0 + np.array(came))
    assert [shot.timestamp for shot in shots] == sorted(shot.timestamp for shot in shots)


def test_a_timeout_ends_before_a_frame_that_is_not_due(clock):
    replay = Replay(Frames([frame(0, 0.0), frame(1, 0.4)]))
    assert replay.next(0.5) is not None
    assert replay.next(0.05) is None
    assert clock.time() == pytest.approx(5000.05)
    assert replay.next(2.0) is not None
    assert clock.time() == pytest.approx(5000.4)


def test_a_clock_that_is_set_back_holds_up_no_replay_and_no_film(clock, film, monkeypatch):
    film(3)
    sources = Replay(Frames([frame(n, 0.1 * n) for n in range(3)])), Simulation("cube_v2", frames=3)
    first = [source.next(0.5) for source in sources]
    monkeypatch.setattr(clock, "time", lambda: clock.now - 3600)
    second = [source.next(0.5) for source in sources]
    for early, late in zip(first, second, strict=True):
        assert late.timestamp - early.timestamp == pytest.approx(0.1)


def test_stamps_of_cameras_move_alike_and_a_missing_image_has_the_frames(clock):
    frames = [frame(0, 10.0, [9.99, 10.0]), frame(1, 10.1, [float("nan"), 10.09])]
    (first, _), (second, _) = all_of(Replay(Frames(frames)), clock)
    assert first.stamps[1] - first.stamps[0] == pytest.approx(0.01)
    assert second.images[0] is None
    assert second.faults[0] == "no image in the recording"
    assert second.stamps[1] - first.stamps[1] == pytest.approx(0.09)


def test_damage_is_raised_after_the_frames_before_it(clock):
    replay = Replay(Frames([frame(0, 0.0), frame(1, 0.01)], error=LogError("frame 2: torn")))
    assert [replay.next(0.5) is not None for _ in range(2)] == [True, True]
    with pytest.raises(LogError, match="torn"):
        replay.next(0.5)


def test_what_waited_is_as_much_older():
    pushed = Pushed()
    pushed.push([None] * 3)
    time.sleep(0.05)
    assert 0.05 <= pushed.next(0.0).age < 5


@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_stamps_are_pushed_as_whatever_holds_them(kind):
    pushed = Pushed()
    pushed.push([None] * 3, kind([1.0, 2.0, 3.0]))
    assert pushed.next(0.0).stamps == (1.0, 2.0, 3.0)
    pushed.push([None] * 3, np.float64(4.0))
    assert pushed.next(0.0).stamps == (4.0,) * 3
    image = np.zeros((2, 2, 3), np.uint8)
    for without in (None, np.nan):
        pushed.push([None, image, image], kind([without, 5.0, 6.0]))
        assert pushed.next(0.0).stamps == (6.0, 5.0, 6.0)
        with pytest.raises(LiveError, match="expected finite numbers of seconds"):
            pushed.push([None, image, image], [5.0, 6.0, without])
        with pytest.raises(LiveError, match="found none for any camera, expected one number"):
            pushed.push([None] * 3, [without] * 3)
    with pytest.raises(LiveError, match="3 images, 2 stamps"):
        pushed.push([None] * 3, kind([1.0, 2.0]))


def test_what_is_pushed_in_another_number_or_too_late_is_refused_at_once():
    pushed = Pushed()
    pushed.push([None] * 3, 1.0)
    with pytest.raises(LiveError, match="images: found 2, expected 3 as before"):
        pushed.push([None] * 2, 2.0)
    assert pushed.next(0.0).stamps == (1.0,) * 3
    pushed.close()
    with pytest.raises(LiveError, match="found the source closed"):
        pushed.push([None] * 3, 3.0)


@pytest.fixture
def film(monkeypatch):
    """Has the simulation draw so many pictures; gives the numbers of those that are drawn, None: closed."""

    def film_of(length, seconds=0.0):
        drawn = []

        def draw(_):
            for number in range(length):
                time.sleep(seconds)
                drawn.append(number)
                yield SimpleNamespace(images=(np.full((2, 2, 3), number, np.uint8),))

        maker = SimpleNamespace(rig=RIG, chunk=draw, close=lambda: drawn.append(None))
        monkeypatch.setattr("tracker.live.sources._maker", lambda *_: maker)
        return drawn

    return film_of


@pytest.mark.parametrize(("length", "shown"), [(4, [0, 1, 2, 3, 2, 1, 0, 1, 2]), (2, [0, 1, 0]), (1, [0, 0])])
def test_a_film_goes_to_and_fro(length, shown, film, clock, monkeypatch):
    film(length)
    monkeypatch.setattr(clock, "sleep", lambda seconds: Clock.sleep(clock, seconds + 1e-3))
    source = Simulation("cube_v2", frames=length)
    assert [source.next(5.0).images[0][0, 0, 0] for _ in shown] == shown


def test_the_simulated_platform_gives_pictures_of_its_rig():
    skip_without_platform()
    with contextlib.closing(Simulation("cube_v2", frames=2)) as source:
        source.draw()  # takes long on a busy machine
        given = [source.next(5.0) for _ in range(2)]
    for shot in given:
        sizes = [image.shape for image in shot.images]
        assert sizes == [(camera.height, camera.width, 3) for camera in source.rig]
    assert given[1].timestamp - given[0].timestamp >= 0.1 - 1e-6


def test_a_tracker_of_other_cameras_is_refused(film):
    drawn = film(1)
    assert open_source("simulation", tracker.ObjectTracker("cube_v2", RIG)).rig is RIG
    other = tracker.CameraRig((RIG.cameras[1], RIG.cameras[0], *RIG.cameras[2:]), arena=RIG.arena)
    with pytest.raises(LiveError, match="a tracker of other cameras"):
        open_source("simulation", tracker.ObjectTracker("cube_v2", other))
    assert drawn == [None]  # closed, and never drawn


def test_the_film_is_drawn_when_it_is_asked_for_and_no_longer_than_one_waits(film):
    drawn = film(3, seconds=0.05)
    source = Simulation("cube_v2", frames=3)
    assert not drawn
    assert source.next(0.01) is None
    assert drawn == [0]
    assert source.draw()
    assert drawn == [0, 1, 2, None]
    before = time.time()
    shot = source.next(5.0)
    assert shot.timestamp >= before  # the film begins when it is shown
    assert shot.images[0][0, 0, 0] == 0


def test_without_the_generator_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr("tracker.live.sources.find_spec", lambda name: None)
    with pytest.raises(LiveError, match=r"pip install .*\[synthetic\]"):
        Simulation("cube_v2")
