import itertools

import numpy as np
import pytest

from tests.helpers.pushed_cube import DT, bits, has_seen, honest, near, play, pose_at
from tracker.errors import ImageError, TrackerError
from tracker.pipeline import Status
from tracker.pose.estimate import PoseEstimator
from tracker.pose.refiner import Refiner
from tracker.pose.views import Reader
from tracker.tracking.belief import Belief

FAULT = 3
"""The images with which something goes wrong."""
NOW = FAULT * DT


def image_of_another_size(images):
    return [images[0], images[1][::2, ::2], images[2]]


def goes_on_as_before(one, short, reference, start):
    """Whether the images from `start` on give what they would have given without a fault before."""
    answers = play(one, short[start:], first=start)
    return bits(*answers) == bits(*reference[start : len(short)])


REFUSED = {
    "wrong size": (ImageError, lambda images: (image_of_another_size(images), NOW)),
    "wrong size and late": (ImageError, lambda images: (image_of_another_size(images), NOW + 7.0)),
    "wrong size at a known stamp": (ImageError, lambda images: (image_of_another_size(images), NOW - DT)),
    "wrong type": (ImageError, lambda images: ([images[0].astype(float), *images[1:]], NOW)),
    "too few images": (ImageError, lambda images: (images[:2], NOW)),
    "too few stamps": (TrackerError, lambda images: (images, [NOW, NOW])),
    "too few known stamps": (TrackerError, lambda images: (images, [NOW - DT] * 2)),
    "no number": (TrackerError, lambda images: (images, "soon")),
    "one NaN": (TrackerError, lambda images: (images, [NOW, np.nan, NOW])),
    "older": (TrackerError, lambda images: (images, NOW - 1.5 * DT)),
    "all older": (TrackerError, lambda images: (images, [NOW - 1.5 * DT] * 3)),
    "older without images": (TrackerError, lambda _: ([None] * 3, NOW - 1.5 * DT)),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_is_refused_changes_nothing_and_does_not_count_as_first(rig, short, reference, fault):
    kind, wrong = REFUSED[fault]
    for start in (FAULT,) if "older" in fault else (FAULT, 0):
        one = has_seen(rig, short[:start])
        for _ in range(2):
            with pytest.raises(kind) as error:
                one.update(*wrong(short[FAULT]))
            assert "\n" not in str(error.value)
        assert goes_on_as_before(one, short, reference, start), start


INSIDE = {
    "light": (Reader, "lit"),
    "labels": (Reader, "labelled"),
    "refine": (Refiner, "__call__"),
    "advance": (Belief, "advance"),
    "plausible": (Belief, "plausible"),
    "updated": (Belief, "updated"),
    "estimate": (Belief, "estimate"),
    "search": (PoseEstimator, "find"),
}
ALWAYS = ("light", "labels", "refine", "advance", "updated", "estimate")
"""What every update of an object that is tracked goes through."""


class Interrupted:
    """Interrupts a method at its `number`th call from now, after its work or before it."""

    def __init__(self, monkeypatch, place, number, after):
        owner, name = place
        method, self.calls = getattr(owner, name), 0

        def broken(*arguments, **named):
            self.calls += 1
            result = method(*arguments, **named) if after or self.calls != number else None
            if self.calls == number:
                raise KeyboardInterrupt
            return result

        monkeypatch.setattr(owner, name, broken)


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("where", INSIDE)
def test_an_update_that_is_broken_off_changes_nothing(rig, short, reference, where, after, monkeypatch):
    for number, lost in itertools.product((1, 3), (False, True)):
        start = 0 if lost else FAULT
        one = has_seen(rig, short[:start])
        with monkeypatch.context() as patch:
            broken = Interrupted(patch, INSIDE[where], number, after)
            try:
                one.update(short[start], DT * start)
            except KeyboardInterrupt:
                pass
            else:
                assert broken.calls < number
                assert lost or number > 1 or where not in ALWAYS
                continue
        assert goes_on_as_before(one, short, reference, start), (number, lost)


DOUBLES = [(1, 1, 2), (2, 1, 2), (0, 0, 2), (0, 2, 2), (0, 1, 0), (0, 1, 1)]
SWAPS = [(0, 2, 1), (1, 0, 2), (2, 1, 0)]
CYCLES = [(1, 2, 0), (2, 0, 1)]


def seen_mixed(rig, short, order, count):
    """A tracker that is shown images in such an order from the fault on, and its answers to these."""
    one = has_seen(rig, short[:FAULT])
    mixed = [[images[c] for c in order] for images in short[FAULT : FAULT + count]]
    return one, play(one, mixed, first=FAULT)


@pytest.mark.parametrize(
    ("order", "count"), [(order, 1) for order in DOUBLES + SWAPS] + [(order, 3) for order in DOUBLES]
)
def test_images_of_cameras_in_anothers_place_give_an_honest_answer(rig, short, order, count):
    one, answers = seen_mixed(rig, short, order, count)
    answers += play(one, short[FAULT + count :], first=FAULT + count)
    for k, answer in enumerate(answers, FAULT):
        assert honest(answer, pose_at(DT * k)), k


@pytest.mark.parametrize("order", SWAPS + CYCLES)
@pytest.mark.parametrize("count", [1, 3])
def test_after_cameras_were_mixed_up_the_object_is_tracked_as_before(rig, short, order, count):
    one, _ = seen_mixed(rig, short, order, count)
    for k in range(FAULT + count, len(short)):
        answer = one.update(short[k], DT * k)
        assert answer.status in (Status.TRACKING, Status.REFOUND)
        assert near(answer, pose_at(DT * k)), k
    assert answer.status is Status.TRACKING
