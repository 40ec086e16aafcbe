import gc
import re
import threading
import time
import weakref
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import tracker
from tests.helpers import RIG, make_rig, run_python
from tests.helpers.filmed import shots
from tests.helpers.log_writers import make_content, write_native
from tests.helpers.pushed_cube import bits
from tracker.errors import LiveError
from tracker.live import ImageSet, Live, Pushed, SourceEnded
from tracker.live.moment import camera_faults
from tracker.pose.result import CameraUse, Status

SHAPE = (4, 6, 3)


class MeanTracker:
    """Answers with the mean of each image; remembers the last stamp, as the forecast."""

    rig = make_rig(6, 4)

    def __init__(self):
        self.last, self.resets, self.seen = None, 0, []
        self.at_work, self.may_go_on = threading.Event(), threading.Event()
        self.may_go_on.set()

    def reset(self):
        self.resets += 1
        self.last = None

    def update(self, images, stamps):
        self.at_work.set()
        assert self.may_go_on.wait(10)
        stamp = max(stamps)
        if self.last is not None and stamp < self.last:
            raise tracker.TrackerError("earlier than before")
        self.last = stamp
        means = tuple(None if image is None else float(image.mean()) for image in images)
        self.seen.append(means)
        return SimpleNamespace(object_pose=means, filtered_object_pose=means, status=Status.FOUND, cameras=())

    def forecast(self):
        last = self.last
        return lambda timestamp: None if timestamp > last + 1 else (last, timestamp)


class Given:
    """Gives shots, then ends, or raises; counts how often it was closed."""

    def __init__(self, *given, error=None):
        self.given, self.error, self.closed = list(given), error or SourceEnded("end"), 0

    def next(self, timeout):
        if not self.given:
            raise self.error
        return self.given.pop(0)

    def close(self):
        self.closed += 1


def images(value):
    return tuple(np.full((3, *SHAPE), value, np.uint8))


def shot(value, stamp, **options):
    return ImageSet(images(value), (stamp,) * 3, **options)


def drain(live):
    """All moments of a source that ends, by a listener's list."""
    while live.running:
        live.wait(timeout=0.05)
    live.close()


def received(*given, finder=None, **options):
    moments, finder, source = [], finder or MeanTracker(), Given(*given, **options)
    with Live(source, finder, listeners=[moments.append]) as live:
        drain(live)
    assert source.closed == 1
    return live, finder, moments


def test_every_set_is_answered_in_order_and_the_latest_stays():
    live, _, moments = received(*(shot(n, np.int64(10 + n), age=np.float32(0)) for n in range(5)))
    assert {type(value) for one in moments for value in (one.timestamp, one.latency)} == {float}  # for JSON
    assert [one.sequence for one in moments] == [0, 1, 2, 3, 4]
    assert [one.timestamp for one in moments] == [10, 11, 12, 13, 14]
    assert [one.object_pose[0] for one in moments] == [0, 1, 2, 3, 4]
    assert live.latest().sequence == 4
    assert live.wait(after=4) is None
    assert not live.running
    # For a moment to come all that was seen counts, for one that has passed what was known then.
    assert [live.at(stamp) for stamp in (14.5, 12.5)] == [(14, 14.5), (12, 12.5)]
    assert live.at(9.0) is None
    assert live.at(16.0) is None  # too long after
    # Only the newest keeps its images, unless a listener keeps them.
    assert all(one.taken.images[0] is not None for one in moments)
    taken = [weakref.ref(one.taken) for one in moments]
    moments.clear()
    assert [one() is not None for one in taken] == [False, False, False, False, True]


def test_a_waiter_gets_what_is_newer_and_never_the_same_again():
    pushed = Pushed()
    with Live(pushed, MeanTracker()) as live:
        assert live.latest() is None
        assert live.wait(timeout=0.01) is None
        assert live.wait(after=-2, timeout=0.01) is None
        pushed.push(images(7), 1.0)
        first = live.wait(after=-1, timeout=60)
        assert first.object_pose == (7, 7, 7)
        assert live.wait(after=first, timeout=0.05) is None
        assert live.latest().sequence == first.sequence
        pushed.push(images(8), 1.0)  # the same stamp: the same set
        assert live.wait(after=first, timeout=0.1) is None
        threading.Timer(0.3, lambda: pushed.push(images(9), 2.0)).start()
        assert live.wait(timeout=60).object_pose == (9, 9, 9)
        threading.Timer(0.1, lambda: pushed.push(images(5), 3.0)).start()
        assert live.wait(timeout=1e10).object_pose == (5, 5, 5)


def test_of_sets_that_wait_only_the_newest_counts():
    pushed, mean = Pushed(), MeanTracker()
    mean.may_go_on.clear()
    with Live(pushed, mean) as live:
        pushed.push(images(0), 0.0)
        assert mean.at_work.wait(10)
        for value in range(1, 6):
            pushed.push(images(value), float(value))  # returns at once
        pushed.finish()
        mean.may_go_on.set()
        drain(live)
    assert mean.seen == [(0, 0, 0), (5, 5, 5)]
    assert pushed.replaced == 4


@pytest.mark.parametrize(
    ("stamps", "jump", "forgotten"),
    [
        ((100.0, 100.1, 50.0, 50.1), r"went back by 50\.100 s: what was before is forgotten", True),
        ((100.0, 100.1, 107.1, 107.2), r"went on by 7\.000 s within [\d.]+ s", False),
    ],
)
def test_stamps_that_jump_are_reported_and_those_that_go_back_start_again(stamps, jump, forgotten):
    live, mean, moments = received(*(shot(1, stamp) for stamp in stamps))
    assert mean.resets == 1 + forgotten  # the first for the first set
    assert [one.timestamp for one in moments] == list(stamps)
    assert [one.jump is None for one in moments] == [True, True, False, True]
    assert [one.jump_count for one in moments] == [0, 0, 1, 1]
    assert re.fullmatch(jump, moments[2].jump)
    assert live.faults == (f"stamps {moments[2].jump}",)
    assert not any(one.faults for one in moments)
    assert (live.at(100.2) is None) == forgotten


def test_each_moment_tells_in_how_many_sets_a_camera_failed_until_then():
    whole, gone = images(0), (images(0)[0], None, images(0)[0])
    _, _, moments = received(*(ImageSet(gone if n % 2 else whole, (float(n),) * 3) for n in range(5)))
    counts = [dict(one.fault_counts) for one in moments]
    assert counts == [{"camera60": 0, "camera180": n, "camera300": 0} for n in (0, 1, 1, 2, 2)]


def test_a_picture_that_cannot_be_used_is_reported_with_its_camera():
    uses = (CameraUse.FROZEN, CameraUse.NO_IMAGE, CameraUse.CONTRADICTING)
    taken = ImageSet((images(0)[0], None, images(0)[0]), (1.0,) * 3, (None, "the buffer failed", None))
    faults = camera_faults(("a", "b", "c"), taken, uses)
    assert faults == {"a": "frozen", "b": "the buffer failed"}


def test_what_a_tracker_saw_before_is_forgotten_at_the_first_set():
    mean = MeanTracker()
    mean.update(images(1), (1000.0,))
    live, *_ = received(shot(2, 0.0), finder=mean)
    assert live.error is None
    closed = weakref.ref(live)
    del live
    gc.collect()
    assert closed() is None  # nothing keeps it and its images until Python ends
    assert mean.seen == [(1, 1, 1), (2, 2, 2)]


LEFT_OPEN = """
import itertools
import queue
import tracker
from tests.live.test_live import Given, Live, MeanTracker, shot

class Endless(Given):
    stamps = itertools.count()

    def next(self, timeout):
        return shot(1, float(next(self.stamps)))

    def close(self):
        print("closed")

tracker.live.live.CLOSING = 0.2
taken = queue.Queue(1)
live = Live(Endless(), MeanTracker(), listeners=[taken.put])  # which waits for others for ever
taken.get()
"""


def test_what_is_left_open_is_closed_when_python_ends():
    done = run_python(["-c", LEFT_OPEN])
    assert (done.returncode, done.stdout, done.stderr) == (0, "closed\n", "")


FORKED = """
import os
import signal
import threading
from tests.live.test_live import LiveError, Live, MeanTracker, Pushed, images
from tracker.live.platform import Frontend

pushed, held, done = Pushed(), threading.Event(), threading.Event()
live, front = Live(pushed, MeanTracker()), Frontend(Pushed(), MeanTracker())
pushed.push(images(7), 1.0)
live.wait(after=-1)

def hold():
    with live._changed:
        held.set()
        done.wait()

threading.Thread(target=hold).start()
held.wait()
if not os.fork():
    signal.alarm(20)
    print(live.running, live.wait(), live.wait(after=-1).sequence, live.at(1.0), live.faults)
    try:
        front.get_latest_observation()
    except LiveError as error:
        print(error, flush=True)
    live.close()
    os._exit(0)
os.wait()
done.set()
live.close()
front.shutdown()
"""


def test_a_fork_knows_that_no_more_will_come_and_waits_for_nothing():
    done = run_python(["-W", "ignore::DeprecationWarning", "-c", FORKED])
    words = "False None 0 (1.0, 1.0) ()\nobservation 0: will not come: the source has ended\n"
    assert (done.returncode, done.stdout, done.stderr) == (0, words, "")


def test_an_episode_that_begins_is_no_fault():
    live, mean, _ = received(shot(1, 0.0, fresh=True), shot(2, 0.1), shot(3, 0.2, fresh=True))
    assert mean.resets == 2
    assert live.faults == ()


@pytest.mark.parametrize("off", [-5.0, 5.0])
@pytest.mark.parametrize("cameras", [2, 3])
def test_a_camera_whose_stamp_jumps_is_left_out_of_that_set(off, cameras):
    given = (*images(1)[:cameras], *[None] * (3 - cameras))
    stamps = ((1.0,) * 3, (1.1, 1.1 + off, 1.1), (1.2,) * 3)
    live, mean, moments = received(*(ImageSet(given, one) for one in stamps))
    assert mean.seen[1] == (1, None, *mean.seen[0][2:])
    assert [one.timestamp for one in moments] == [1.0, 1.1, 1.2]
    assert "camera180: its stamp is" in live.faults[0]
    assert moments[1].taken.faults[1] is not None
    absent = {} if cameras == 3 else {"camera300": "no_image"}
    assert moments[1].faults == {"camera180": f"its stamp is {off:+.3f} s from the others'", **absent}


@pytest.mark.parametrize("off", [1.5, 5.0])
def test_of_two_images_of_the_first_set_that_are_apart_the_later_is_used(off):
    given = ImageSet((*images(1)[:2], None), (10.0, 10.0 + off, 10.0))
    live, mean, (one,) = received(given)
    assert mean.seen == [(None, 1, None)]
    assert one.timestamp == 10.0 + off
    assert live.faults == (f"camera60: its stamp is {-off:+.3f} s from the others'",)


@pytest.mark.parametrize(
    "others", [images(0)[1:], (np.zeros((2, 2, 3), np.uint8),) * 2], ids=["black", "small"]
)
def test_stamps_of_images_that_show_nothing_do_not_outvote_that_of_one_that_does(others):
    sets = ImageSet(images(50), (1.0,) * 3), ImageSet((images(50)[0], *others), (1.1, 0.0, 0.0))
    _, mean, moments = received(*sets)
    assert mean.seen == [(50,) * 3, (50, None, None)]
    assert mean.resets == 1
    assert [one.timestamp for one in moments] == [1.0, 1.1]


def test_an_image_that_cannot_be_used_is_left_out_with_its_raw_pixels_and_no_other():
    given = (np.zeros(SHAPE, np.uint8), np.zeros((2, 2, 3), np.uint8), np.zeros(SHAPE))
    raw = tuple(image[..., 0] for image in given)
    live, mean, (one,) = received(ImageSet(given, (1.0,) * 3, raw=raw))
    with pytest.raises(LiveError, match="timestamp: found 'now'"):
        live.at("now")
    assert mean.seen == [(0.0, None, None)]
    assert [found is None for found in one.taken.raw] == [False, True, True]
    assert "camera180: found 2x2 px, expected 6x4 as it is calibrated" in live.faults
    assert any(fault.startswith("camera300: found float64") for fault in live.faults)
    live, _, _ = received(ImageSet((given[0], given[0], [1, 2, 3]), (1.0,) * 3))
    assert live.error is None
    assert any(fault.startswith("camera300: found a list of 3, expected uint8") for fault in live.faults)


@pytest.mark.parametrize(
    ("second", "error", "words"),
    [
        (None, LiveError("camera60: gone for good"), "camera60: gone for good"),
        (None, MemoryError(), "live: MemoryError"),
        (ImageSet(images(0)[:2], (2.0,) * 2), None, "2 images, expected one for each of camera60, .*camera3"),
    ],
)
def test_a_source_that_breaks_says_so_to_those_who_wait(second, error, words):
    live, _, moments = received(*filter(None, (shot(1, 1.0), second)), error=error)
    assert len(moments) == 1
    assert live.latest() is not None
    with pytest.raises(LiveError, match=words):
        live.wait(timeout=1)


@pytest.mark.parametrize("asked", [KeyboardInterrupt, SystemExit])
def test_a_source_that_asks_to_end_reaches_the_caller_as_it_is(asked):
    live = Live(Given(shot(1, 1.0), error=asked("now")), MeanTracker())
    live.wait(after=-1, timeout=60)
    with pytest.raises(asked, match="now"):
        live.wait(after=0, timeout=60)
    assert isinstance(live.error, asked)

    def poll():
        with Live(Given(error=asked("now")), MeanTracker()) as live:
            while live.running:
                live.latest()

    with pytest.raises(asked, match="now"):
        poll()


def test_a_listener_that_raises_is_not_called_again_and_harms_nobody():
    broken, other = Mock(side_effect=RuntimeError("disk full")), Mock()
    with Live(Given(shot(1, 1.0), shot(2, 2.0)), MeanTracker(), listeners=[broken, other]) as live:
        drain(live)
    assert (broken.call_count, other.call_count) == (1, 2)
    assert "disk full" in live.faults[0]


def test_a_source_can_be_named(tmp_path):
    path, mean = write_native(tmp_path / "camera_data.dat", make_content(3, size=24)), MeanTracker()
    mean.rig = make_rig(24, 24)
    with Live(path, mean) as live:
        drain(live)
    assert live.error is None
    assert len(mean.seen) >= 1
    with pytest.raises(tracker.TrackerError, match="no such file"):
        Live("nowhere", mean)
    mean.rig = tracker.CameraRig(mean.rig.cameras[::-1])
    with pytest.raises(LiveError, match="camera60, camera180, camera300, expected camera300, "):
        Live(path, mean)


def test_closing_ends_a_thread_that_waits_for_images():
    live = Live(Pushed(), MeanTracker())
    start = time.monotonic()
    live.close()
    live.close()
    assert time.monotonic() - start < 5
    assert not live.running
    assert live.wait() is None


def test_a_source_that_does_not_return_is_left_and_reported(monkeypatch):
    monkeypatch.setattr("tracker.live.live.CLOSING", 0.2)
    go_on, source, moments = threading.Event(), Given(), []
    source.next = lambda _: go_on.wait(30) and shot(1, 1.0)
    live = Live(source, MeanTracker(), listeners=[moments.append])
    start = time.monotonic()
    live.close()
    assert time.monotonic() - start < 10
    assert not live.running
    assert live.wait() is None
    assert live.faults == ("the source does not return: not closed after 0.2 s",)
    go_on.set()
    live._thread.join(30)
    assert source.closed == 1
    assert not moments  # what comes too late is dropped


def test_live_poses_are_those_of_the_tracker():
    model, film = tracker.load_object("cube_v2"), shots("cube_v2", 2, seed=621)
    sets = [film[0].images, film[0].images, [None, *film[0].images[1:]], film[1].images]
    noise = np.random.default_rng(5)
    sets = [
        [None if im is None else im ^ noise.integers(0, 2, im.shape, np.uint8) for im in one] for one in sets
    ]
    alone = tracker.ObjectTracker(model, RIG)
    expected = [alone.update(images, 0.1 * n) for n, images in enumerate(sets)]
    given = (ImageSet(tuple(images), (0.1 * n,) * 3) for n, images in enumerate(sets))
    live, _, moments = received(*given, finder=tracker.ObjectTracker(model, RIG))
    assert bits(*(one.observation for one in moments)) == bits(*expected)
    assert moments[2].cameras[0] is CameraUse.NO_IMAGE
    ahead, other = live.at(0.35), alone.predict(0.35)
    assert np.array_equal(ahead.position, other.position)
    assert moments[0].latency > 0


@pytest.mark.parametrize(
    ("rows", "words"), [(2, "camera180: found 6x2 px"), (4, "camera180: its stamp is +2.119 s")]
)
def test_a_fault_of_every_set_does_not_drive_out_another(rows, words):
    image, *_ = images(0)
    stamps = ((t, 2.0 + 1.01 * t, t) for t in 0.1 * np.arange(120))  # one clock is fast
    sets = (ImageSet((image, image[:rows], image), its) for its in stamps)
    live, _, _ = received(shot(0, 0.0), shot(0, -0.5), *sets)
    back, found = live.faults
    assert "went back" in back
    assert found.startswith(words)
