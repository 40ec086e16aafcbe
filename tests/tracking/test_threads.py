import contextlib
import copy
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.helpers.pushed_cube import DT, all_bits, bits, new, play, shot
from tests.tracking.conftest import has_seen
from tracker.errors import ImageError, TrackerError

THREADS = 4
CALLS = 25


@pytest.fixture(scope="module")
def sets(rig, short):
    """Images of all three cameras, of two, of one, and of an arena without object."""
    return [short[0], [short[3][0], None, short[3][2]], [None, short[5][1], None], shot(rig, None, 100)]


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


def test_detections_from_many_threads_give_the_bits_of_one_though_others_are_refused(rig, sets):
    # The first ones of the tracker, too.
    one, other = new(rig), new(rig)
    alone = [detections(other, sets, k) for k in range(THREADS)]

    def work(k):
        if k < THREADS:
            return detections(one, sets, k)
        for _ in range(CALLS):
            with pytest.raises(ImageError):
                one.detect([None] * 3)
        return None

    assert together(work, THREADS + 1) == [*alone, None]


def test_detections_beside_updates_change_neither(rig, short, sets):
    one = new(rig)
    updates, alone = all_bits(play(new(rig), short)), detections(one, sets, 0)

    def work(k):
        return detections(one, sets, 0) if k else all_bits(play(one, short))

    assert together(work, THREADS) == [updates, *[alone] * (THREADS - 1)]


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
def test_a_second_caller_is_refused_and_changes_nothing(rig, short, second, monkeypatch):
    one, answers = new(rig), all_bits(play(new(rig), short))
    assert bits(one.update(short[0], 0.0)) == answers[0]
    calls = {
        "update": lambda: one.update(short[2], 2 * DT),
        "same stamp": lambda: one.update(short[0], 0.0),
        "reset": one.reset,
    }
    with updating(one, short[1], monkeypatch) as first:
        with pytest.raises(TrackerError, match="another call") as error:
            calls[second]()
        assert "\n" not in str(error.value)
    assert bits(first.result()) == answers[1]
    assert all_bits(one.update(short[k], DT * k) for k in range(2, 8)) == answers[2:]


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


def test_of_callers_at_once_those_who_are_not_refused_get_the_same_answer(rig, short):
    one, answer = new(rig), bits(new(rig).update(short[0], 0.0))

    def work(_):
        try:
            return bits(one.update(short[0], 0.0))
        except TrackerError as error:
            return str(error)

    found = together(work, THREADS)
    assert answer in found
    assert all(item == answer or "another call" in item for item in found)


def pickled(one):
    return pickle.loads(pickle.dumps(one))


copies = pytest.mark.parametrize("copied", [pickled, copy.deepcopy])


@copies
def test_a_copy_answers_as_the_tracker_would(rig, short, sets, copied):
    one = has_seen(rig, short[:4])
    other = copied(one)
    assert [bits(other.detect(images)) for images in sets] == [bits(one.detect(images)) for images in sets]
    # The same stamp is known to both.
    assert bits(other.update(sets[3], 3 * DT)) == bits(one.update(sets[3], 3 * DT))
    assert all_bits(play(other, short[4:], start=4 * DT)) == all_bits(play(one, short[4:], start=4 * DT))


@copies
def test_what_a_copy_sees_does_not_change_the_tracker(rig, short, copied):
    one, answers = has_seen(rig, short[:3]), play(new(rig), short[:6])
    other = copied(one)
    play(other, short[:2:-1], start=3 * DT)
    other.reset()
    assert all_bits(one.update(short[k], DT * k) for k in range(3, 6)) == all_bits(answers[3:])


@copies
def test_a_copy_made_during_an_update_is_free(rig, short, copied):
    one, answers = new(rig), all_bits(play(new(rig), short[:2]))
    one.update(short[0], 0.0)
    with one._gate:
        other = copied(one)
        assert bits(other.update(short[1], DT)) == answers[1] != bits(new(rig).update(short[1], DT))
        with pytest.raises(TrackerError, match="another call"):
            one.update(short[1], DT)
