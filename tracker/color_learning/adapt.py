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

from tracker.color_learning.fit import FitOptions, Histograms, combine, pixel_histograms
from tracker.color_learning.hues import NAMED_HUES, bgr_of_hue, hue_of, hues_of_model, misnamed
from tracker.color_learning.lessons import Frames, Judgement, Lesson, consistent, judge, lesson, nodes_of
from tracker.conventions import Array
from tracker.errors import ColorModelError, NotBetterError
from tracker.objects.labels import COLOR_NAMES
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import confidence
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel, color_model_names, load_colors

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
    """Colours for an object as recordings show it, after up to `rounds` turns.

    start: the colours to begin with; pictures are read in neutral light, whatever it says.
    say: takes a line about each turn.

    Raises:
        ColorModelError: the colours to begin with are misnamed.
        NotBetterError: nothing could be learned, or nothing was gained, and why.
    """
    if wrong := _told_wrong(hues_of_model(start)):
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
        lessons, fault = _lessons(model, footage, colors, gate)
        if fault:
            break
        pixels = consistent(lessons)
        counts = learned(pixels)
        # Faces in all frames together must have the hues of their names, too.
        hues = {k: hue_of(np.concatenate([one[k] for one in pixels if k in one])) for k in counts}
        if fault := _told_wrong(hues):
            break
        strays = sum(np.bincount(nodes_of(one.levels[one.stray]), minlength=NODES**3) for one in lessons)
        mistaken |= strays >= OFTEN
        colors = refit(pixels, mistaken, remembered, options, name)
        after = judge(model, footage, colors)
        say(f"round {turn + 1}: {len(lessons)} frames of confidence {gate:g} teach; {after}")
        idle += 1
        if after.explained > best.after.explained + GAIN:
            idle = 0
            taught = {COLOR_NAMES[k]: counts.get(k, 0) for k in range(1, CLASSES)}
            best = Adapted(colors, before, after, taught)
        if idle >= PATIENCE and gate == GATES[-1]:
            break
    if best.after is before:
        fault = fault or f"frames that only check are explained no better than before: {before}"
        raise NotBetterError(f"{start.name}: refused: {fault}")
    return best


def _lessons(
    model: CuboidModel, footage: Sequence[Frames], colors: ColorModel, gate: float
) -> tuple[list[Lesson], str]:
    """Frames of sure poses whose faces have the hues of their names; or why there are too few."""
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
    if len(result) >= FEW:
        return result, ""
    count = sum(len(one.learned) for one in footage)
    fault = (
        f"found {len(result)} of {count} frames with a pose of confidence {gate:g} or more, expected {FEW}"
    )
    return [], f"{fault}; in {off} more the faces have not the hues of their names" if off else fault


def _told_wrong(hues: Mapping[int, float]) -> str:
    """In words, which faces have not the hues of their names; empty: none."""
    parts = [
        f"{COLOR_NAMES[label]} has the hue of {COLOR_NAMES[like] if like else 'grey'}"
        for label, like in misnamed(hues).items()
    ]
    return "faces are mistaken for each other: " + ", ".join(parts) if parts else ""


TRIED = 12
"""Frames on which the models compete."""

_OF_MANY_THINGS = "dice"
"""A model of one colour, which no cuboid has."""


def nearest(model: CuboidModel, footage: Sequence[Frames]) -> ColorModel:
    """The shipped colour model that explains most of some of the frames that teach."""
    step = max(1, sum(len(one.learned) for one in footage) // TRIED)
    few = [dataclasses.replace(one, learned=(), held_out=one.learned[::step]) for one in footage]
    names = [name for name in color_model_names() if name != _OF_MANY_THINGS]
    models = [dataclasses.replace(load_colors(name), normalise=True) for name in names]
    return max(models, key=lambda colors: judge(model, few, colors).explained)


DRAWN = 40_000
"""Pixels that stand for each colour of which only the name is known."""

HUE_SPREAD = 12.0
"""Standard deviation of a paint's hue around that of its name [degrees]."""

LEVELS, SATURATIONS = (25.0, 255.0), (0.4, 1.0)
"""Of the brightest channel of a face's pixel, and of its saturation: the rest of its largest channel."""

GREY = 0.25
"""Saturation up to which anything may be grey."""


def from_names(seed: int) -> ColorModel:
    """A colour model that knows of the faces the names of their colours alone.

    Pixels are drawn around each name's hue, of any brightness and of all but pale saturations; background
    is what is nearly grey.
    """
    rng = np.random.default_rng([seed, 7])
    many = 4 * DRAWN
    pixels = {
        0: bgr_of_hue(rng.uniform(0, 360, many), rng.uniform(0.0, GREY, many), rng.uniform(0.0, 255.0, many))
    }
    for label in range(1, CLASSES):
        hues = NAMED_HUES[label] + HUE_SPREAD * rng.standard_normal(DRAWN)
        pixels[label] = bgr_of_hue(hues, rng.uniform(*SATURATIONS, DRAWN), rng.uniform(*LEVELS, DRAWN))
    options = FitOptions(seed=seed)
    return combine([pixel_histograms(pixels, options, rng)], (), options, name="names")


GROUPS = 6
"""Groups of frames that count the same, whatever they show."""

ENOUGH = 150
"""Pixels of a colour, in all frames, from which it is learned."""

DISTRACTING = 0.2
"""Share of the background's draws that show what is taken for a face though it is none, if anything is: a
cross on the table fills a thousandth of the pictures."""

MOST = 200_000
"""Pixels of the background that are kept of a group."""


def learned(pixels: Sequence[Mapping[int, Array]]) -> dict[int, int]:
    """Pixels of each face colour of which there is enough to learn from."""
    counts = {label: sum(len(one.get(label, ())) for one in pixels) for label in range(1, CLASSES)}
    return {label: count for label, count in counts.items() if count >= ENOUGH}


def refit(
    pixels: Sequence[Mapping[int, Array]],
    taken: Array,
    before: Sequence[ColorModel],
    options: FitOptions,
    name: str,
) -> ColorModel:
    """A colour model fitted to frames' pixels (N, 3) in neutral light by label, 0 for background.

    taken: (32³,) bool: colours that were taken for a face by mistake.
    before: models of which a little is kept, and all of what the frames do not show.
    """
    rng = np.random.default_rng([options.seed, *name.encode()])
    labels, groups = learned(pixels), min(GROUPS, len(pixels))
    histograms: list[Histograms] = []
    for group in range(groups):
        parts: dict[int, Array] = {}
        for label in (*labels, 0):
            some = [one[label] for one in pixels[group::groups] if len(one.get(label, ()))]
            if some:
                parts[label] = np.concatenate(some)
        if 0 in parts:
            parts[0] = _with_distracting(parts[0], taken, rng)
        histograms.append(pixel_histograms(parts, options, rng))
    return combine(histograms, [_remembered(one) for one in before], options, name=name)


def _with_distracting(background: Array, taken: Array, rng: np.random.Generator) -> Array:
    """Background in which DISTRACTING of all pixels have colours that are taken for a face, if some have."""
    distracting = background[taken[nodes_of(background)]]
    if len(background) > MOST:
        background = background[rng.integers(len(background), size=MOST)]
    if not len(distracting):
        return background
    more = round(DISTRACTING / (1.0 - DISTRACTING) * len(background))
    return np.concatenate([background, distracting[rng.integers(len(distracting), size=more)]])


def _remembered(model: ColorModel) -> Histograms:
    """What a model knows of its face colours, as densities over colours that are all as likely."""
    posterior = np.exp(model.log_posterior)
    posterior /= posterior.sum(axis=0)
    return {label: posterior[label] / posterior[label].sum() for label in range(1, CLASSES)}
