import contextlib
import copy
import dataclasses
import pickle
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import tracker
from tests.helpers.pushed_cube import DT, bits, has_seen, new, play, shot
from tracker.errors import ImageError, TrackerError
from tracker.tracking import follow

THREADS = 4
CALLS = 25


@pytest.fixture(scope="module")
def sets(rig, short):
    """Images of all three cameras, of two, of one, one of another moment, and an arena without object."""
    two, one = [short[3][0], None, short[3][2]], [None, short[5][1], None]
    return [short[0], two, one, [*short[0][:2], short[7][2]], shot(rig, None, 100)]


def together(work, count):
    """Results of `work(k)` for each of `count` threads that begin at once."""
    ready = threading.Barrier(count)

    def begin(k):
        ready.wait(60)
        return work(k)

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(begin, range(count)))


def detections(one, sets, k):
    """Bits of many detections, every thread beginning with another set."""
    return [bits(one.detect(sets[(k + call) % len(sets)])) for call in range(CALLS)]


def test_calls_from_many_threads_give_the_bits_of_one_though_others_are_refused(rig, short, sets, reference):
    # The first ones of the tracker, too.
    one, other = new(rig), new(rig)
    alone = [detections(other, sets, k) for k in range(THREADS)]

    def work(k):
        if k < THREADS:
            return detections(one, sets, k)
        if k == THREADS:
            return bits(*play(one, short))
        for _ in range(CALLS):
            with pytest.raises(ImageError):
                one.detect([None] * 3)
        return None

    assert together(work, THREADS + 2) == [*alone, bits(*reference[:8]), None]


@contextlib.contextmanager
def updating(one, images, monkeypatch):
    """While a tracker's update at the stamp DT stands still in its middle; gives what will come of it."""
    inside, go_on, measure = threading.Event(), threading.Event(), one._follow._measure

    def held(*arguments):
        inside.set()
        assert go_on.wait(60)
        return measure(*arguments)

    with monkeypatch.context() as patch, ThreadPoolExecutor(1) as pool:
        patch.setattr(one._follow, "_measure", held)
        first = pool.submit(one.update, images, DT)
        try:
            assert inside.wait(60)
            yield first
        finally:
            go_on.set()


@pytest.mark.parametrize("second", ["update", "same stamp", "reset"])
def test_a_second_caller_is_refused_and_changes_nothing(rig, short, reference, second, monkeypatch):
    one = has_seen(rig, short[:1])
    calls = {
        "update": lambda: one.update(short[2], 2 * DT),
        "same stamp": lambda: one.update(short[0], 0.0),
        "reset": one.reset,
    }
    with updating(one, short[1], monkeypatch) as first:
        with pytest.raises(TrackerError, match="another call") as error:
            calls[second]()
        assert "\n" not in str(error.value)
    assert bits(first.result(), *play(one, short[2:], first=2)) == bits(*reference[1:8])


def test_detection_and_prediction_do_not_wait_for_an_update(rig, short, sets, monkeypatch):
    one = new(rig)
    one.update(short[0], 0.0)
    seen, expected = bits(one.detect(sets[1])), one.predict(DT)
    with updating(one, short[1], monkeypatch) as first:
        assert bits(one.detect(sets[1])) == seen
        meanwhile = one.predict(DT)
        assert not first.done()
    first.result()
    assert meanwhile.position.tobytes() == expected.position.tobytes()
    assert meanwhile.covariance.tobytes() == expected.covariance.tobytes()


def test_of_callers_at_once_those_who_are_not_refused_get_the_same_answer(rig, short, reference):
    one, answer = new(rig), bits(reference[0])

    def work(_):
        try:
            return bits(one.update(short[0], 0.0))
        except TrackerError as error:
            return str(error)

    found = together(work, THREADS)
    assert answer in found
    assert all(item == answer or "another call" in item for item in found)


ways = [lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy, copy.copy]
copies = pytest.mark.parametrize("copied", ways)


@copies
def test_a_copy_answers_as_the_tracker_would_and_does_not_change_it(rig, short, sets, reference, copied):
    one = has_seen(rig, short[:4])
    other = copied(one)
    assert bits(*map(other.detect, sets)) == bits(*map(one.detect, sets))
    # The same stamp is known to both.
    assert bits(other.update(sets[-1], 3 * DT)) == bits(one.update(sets[-1], 3 * DT))
    assert bits(*play(other, short[4:], first=4)) == bits(*reference[4:8])
    other.reset()
    assert bits(*play(one, short[4:], first=4)) == bits(*reference[4:8])


@copies
def test_arrays_of_a_copy_are_read_only_as_those_that_it_copies(rig, short, copied):
    model, colors = tracker.load_object("cube_v2"), tracker.load_colors("cube_v2")
    placed = tracker.tasks.rearrange_dice.assign([[0, 0, 0]], [])
    for one in (rig[0], model, colors, placed, new(rig).update(short[0], 0.0).filtered_object_pose):
        names = [field.name for field in dataclasses.fields(one)]
        values = [getattr(each, name) for each in (one, copied(one)) for name in names]
        assert not any(value.flags.writeable for value in values if isinstance(value, np.ndarray))


@copies
def test_a_copy_made_during_an_update_is_free(rig, short, reference, copied):
    one = has_seen(rig, short[:1])
    with one._gate.lock():
        other = copied(one)
        found = bits(other.update(short[1], DT))
        assert found == bits(reference[1]) != bits(new(rig).update(short[1], DT))
        with pytest.raises(TrackerError, match="another call"):
            one.update(short[1], DT)


def test_an_interrupted_call_leaves_no_lock():
    gate, interrupted = follow.Gate(), 0

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGVTALRM, interrupt)
    try:
        for _ in range(20):
            try:
                signal.setitimer(signal.ITIMER_VIRTUAL, 1e-4)
                while True:
                    with gate.lock():
                        pass
            except KeyboardInterrupt:
                interrupted += 1
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
    assert interrupted == 20
    with gate.lock(), pytest.raises(TrackerError, match="another call"):
        gate.lock()


def test_a_thread_of_one_process_does_not_keep_a_fork_of_it_from_updating(monkeypatch):
    gate = follow.Gate()
    with gate.lock(), monkeypatch.context() as fork:
        fork.setattr(follow.os, "getpid", lambda: -1)
        with gate.lock():
            pass
