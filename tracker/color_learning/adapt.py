"""Learn an object's colours from recordings without labels, by turns of finding poses and fitting colours.

Poses of which the tracker is sure say where faces are; their pixels, and all that is not the object, are
what a person would have painted. A fit to them finds more poses, and so on until nothing is gained. Two
things keep it from talking itself into an error: faces must have the hues of their names, and frames that
taught nothing must be explained better than before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.color_learning.fit import FitOptions
from tracker.color_learning.hues import hue_of, hues_of_model, misnamed
from tracker.color_learning.lessons import Frames, Judgement, Lesson, consistent, judge, lesson, nodes_of
from tracker.color_learning.models import from_names, learned, refit
from tracker.conventions import Array
from tracker.errors import ColorModelError, NotBetterError
from tracker.objects.labels import COLOR_NAMES
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import confidence
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel

GATES = (0.3, 0.5, 0.7, 0.8, 0.9)
"""Least confidence of the poses that teach, round by round: at first few are sure."""

FEW = 2
"""Frames that must teach, at least."""

GAIN = 0.002
"""Least gain of what is explained with which a fit counts as better."""

OFTEN = 5
"""Pixels of a colour that are taken for a face by mistake, from which it is no chance."""

PATIENCE = 2
"""Rounds without a gain after which it has settled."""


@dataclass(frozen=True, eq=False)
class Adapted:
    """Colours learned, and how good they are."""

    colors: ColorModel
    """The new model."""
    before: Judgement
    """Of the model to begin with."""
    after: Judgement
    """Of the new one."""
    pixels: dict[str, int]
    """Pixels of each face colour that taught; a colour with 0 stays as it was before."""


class _Stuck(Exception):
    """Why there is no further turn."""


def adapt(
    model: CuboidModel,
    footage: Sequence[Frames],
    start: ColorModel,
    options: FitOptions,
    *,
    name: str,
    rounds: int = 8,
    say: Callable[[str], None] = lambda _: None,
) -> Adapted:
    """Colours for an object as recordings show it.

    Args:
        model: the object.
        footage: frames of the recordings.
        start: the colours to begin with; pictures are read in neutral light, whatever it says.
        options: of the fits.
        name: of the new colour model.
        rounds: most turns.
        say: takes a line about each turn.

    Raises:
        ColorModelError: the colours to begin with are misnamed.
        NotBetterError: nothing could be learned, or nothing was gained, and why.
    """
    if wrong := _told_wrong(misnamed(hues_of_model(start))):
        raise ColorModelError(f"colour model {start.name}: refused: {wrong}")
    colors = dataclasses.replace(start, normalise=True)
    before = judge(model, footage, colors)
    say(f"{start.name}: {before}")
    best = Adapted(colors, before, before, dict.fromkeys(COLOR_NAMES[1:], 0))
    remembered = [colors, from_names(options.seed)]
    mistaken = np.zeros(NODES**3, dtype=bool)
    fault, idle = "", 0
    for turn in range(rounds):
        gate = GATES[min(turn, len(GATES) - 1)]
        try:
            lessons = _lessons(model, footage, colors, gate)
            pixels = _checked(consistent(lessons))
        except _Stuck as stuck:
            fault = str(stuck)
            break
        mistaken |= _mistaken(lessons)
        colors = refit(pixels, mistaken, remembered, options, name)
        after = judge(model, footage, colors)
        say(f"round {turn + 1}: {len(lessons)} frames of confidence {gate:g} teach; {after}")
        better = after.explained > best.after.explained + GAIN
        if better:
            counts = learned(pixels)
            best = Adapted(
                colors, before, after, {COLOR_NAMES[k]: counts.get(k, 0) for k in range(1, CLASSES)}
            )
        idle = 0 if better else idle + 1
        if idle >= PATIENCE and gate == GATES[-1]:
            break
    if best.after is before:
        fault = fault or f"frames that only check are explained no better than before: {before}"
        raise NotBetterError(f"{start.name}: refused: {fault}")
    return best


def _mistaken(lessons: Sequence[Lesson]) -> Array:
    """(32³,) bool: colours in which things that are not the object are taken for faces."""
    counts = sum(np.bincount(nodes_of(one.levels[one.stray]), minlength=NODES**3) for one in lessons)
    return np.asarray(counts >= OFTEN)


def _lessons(model: CuboidModel, footage: Sequence[Frames], colors: ColorModel, gate: float) -> list[Lesson]:
    """Frames whose pose is sure enough, and whose faces have the hues of their names."""
    result, off = [], 0
    for one in footage:
        tracker = ObjectTracker(model, one.rig, colors)
        for images in one.learned:
            fit = tracker.fit(images)
            if not isinstance(fit, Fit) or confidence(fit) < gate:
                continue
            seen = lesson(model, one.rig, images, fit, colors)
            if misnamed(seen.hues()):
                off += 1
            else:
                result.append(seen)
    if len(result) < FEW:
        count = sum(len(one.learned) for one in footage)
        found = f"found {len(result)} of {count} frames"
        text = f"{found} with a pose of confidence {gate:g} or more, expected {FEW}"
        raise _Stuck(f"{text}; in {off} more the faces have not the hues of their names" if off else text)
    return result


def _checked(pixels: list[Mapping[int, Array]]) -> list[Mapping[int, Array]]:
    """The pixels, if the faces in all frames together have the hues of their names."""
    hues = {
        label: hue_of(np.concatenate([one[label] for one in pixels if label in one]))
        for label in learned(pixels)
    }
    if wrong := _told_wrong(misnamed(hues)):
        raise _Stuck(wrong)
    return pixels


def _told_wrong(wrong: Mapping[int, int]) -> str:
    """In words, which faces have not the hues of their names; empty: none."""
    parts = [
        f"{COLOR_NAMES[label]} has the hue of {COLOR_NAMES[like] if like else 'grey'}"
        for label, like in wrong.items()
    ]
    return "faces are mistaken for each other: " + ", ".join(parts) if parts else ""
