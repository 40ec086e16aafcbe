"""Learn an object's colours from recordings without labels, by alternately finding poses and fitting colours.

Confident poses show which pixels belong to which face and which show no object; they replace labels drawn by
hand. A colour model fitted to these pixels finds more poses, and so on until nothing is gained. Two checks
keep it from reinforcing its own errors: faces must have the hues of their names, and held-out frames must
be explained better than before.

Images are read in neutral light, so that the model fits other light, too. On a table that is not grey, this
makes the table grey and gives the faces other hues: then images are read as they are.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from tracker.color_learning.fit import FitOptions, Histograms, combine, pixel_histograms
from tracker.color_learning.hues import NAMED_HUES, bgr_of_hue, hue_of, hues_of_model, misnamed
from tracker.color_learning.lessons import Frames, Judgement, Lesson, consistent, judge, lesson, nodes_of
from tracker.conventions import Array
from tracker.errors import ColorModelError, NotBetterError
from tracker.logs.log import evenly
from tracker.objects.labels import COLOR_NAMES
from tracker.objects.model import CuboidModel
from tracker.pipeline import SAMPLE, ObjectTracker, another_shown
from tracker.pose.fit import Fit
from tracker.pose.judge import confidence
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel, color_model_names, load_colors

GATES = (0.3, 0.5, 0.7, 0.8, 0.9)
"""Smallest confidence of a pose to learn from, round by round: at first, few poses are confident."""

FEW = 2
"""Smallest number of frames to learn from."""

GAIN = 0.002
"""Smallest gain of `Judgement.explained` with which a fit counts as better."""

ENOUGH_POSED = 0.5
"""Share of frames with a pose above which learning may end because too few poses are confident."""

OFTEN = 5
"""Number of pixels of one colour, mistaken for a face in one round, that cannot be due to chance."""

PATIENCE = 2
"""Number of rounds without a gain after which learning ends."""


@dataclass(frozen=True, eq=False)
class Adapted:
    """A learned colour model, with judgements of the initial and of the new one."""

    colors: ColorModel
    before: Judgement
    after: Judgement
    pixels: dict[str, int]
    """Number of pixels that each face colour was learned from; a colour with 0 stays as it was before."""


def adapt(
    model: CuboidModel,
    footage: Sequence[Frames],
    start: ColorModel | None,
    options: FitOptions,
    *,
    rounds: int = 8,
    first: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Adapted:
    """Learn an object's colours from recordings in up to `rounds` rounds.

    start: the initial model, whose `normalise` is ignored; None: the `nearest`.
    first: whether the object has no model yet, so that the initial one is kept if nothing is gained.
    say: receives a line about each round.

    ColorModelError if the colours of the initial model are misnamed; NotBetterError, which says why, if
    nothing could be learned, nothing was gained, or the images show another object.
    """
    faults: list[str] = []
    tried: list[Adapted] = []
    for normalise in (True, False):
        initial = start or nearest(model, footage, options.seed, normalise)
        initial = dataclasses.replace(initial, normalise=normalise)
        if wrong := _told_wrong(hues_of_model(initial)):
            raise ColorModelError(f"colour model {initial.name}: refused: {wrong}")
        found, fault = _adapted(model, footage, initial, options, rounds, say)
        tried.append(found)
        best = max(tried, key=lambda one: one.after.explained)
        if not fault:
            break
        faults.append(f"{initial.name}: refused: {fault}")
        if normalise:
            say(f"{faults[0]}\nin images as they are:")
    for one in footage:
        few = evenly(one.held_out, SAMPLE)
        if another := another_shown(ObjectTracker(model, one.rig, best.colors), few):
            raise NotBetterError(f"{initial.name}: refused: {another}")
    if best.after is best.before and (faults or not first):
        instead = f"{initial.name} (see --colors): {best.before}"
        faults.append(f"{initial.name}: refused: held-out frames are explained no better than by {instead}")
        raise NotBetterError(faults[0])
    return best


def _adapted(
    model: CuboidModel,
    footage: Sequence[Frames],
    start: ColorModel,
    options: FitOptions,
    rounds: int,
    say: Callable[[str], None],
) -> tuple[Adapted, str]:
    """Learn in the light of the initial model; return the best round, and why the rounds ended too soon."""
    colors, before = start, judge(model, footage, start)
    say(f"{start.name}: {before}")
    best = Adapted(start, before, before, dict.fromkeys(COLOR_NAMES[1:], 0))
    remembered = [start, from_names(options.seed)]
    mistaken = np.zeros(NODES**3, dtype=bool)
    fault, idle = "", 0
    for turn in range(rounds):
        gate = GATES[min(turn, len(GATES) - 1)]
        lessons, too_few = _lessons(model, footage, colors, gate)
        if too_few:
            fault = "" if turn and best.after.posed > ENOUGH_POSED else too_few
            break
        pixels = consistent(lessons)
        counts = learned(pixels)
        # Pooled over all frames, faces must also have the hues of their names.
        hues = {k: hue_of(np.concatenate([one[k] for one in pixels if k in one])) for k in counts}
        if fault := _told_wrong(hues):
            break
        strays = sum(np.bincount(nodes_of(one.levels[one.stray]), minlength=NODES**3) for one in lessons)
        mistaken |= strays >= OFTEN
        fitted = refit(pixels, mistaken, remembered, options)
        colors = dataclasses.replace(fitted, normalise=start.normalise)
        after = judge(model, footage, colors)
        say(f"round {turn + 1}: learned from {len(lessons)} frames of confidence {gate:g} or more; {after}")
        idle += 1
        if after.posed and after.explained > best.after.explained + GAIN:
            idle = 0
            taught = {COLOR_NAMES[k]: counts.get(k, 0) for k in range(1, CLASSES)}
            best = Adapted(colors, before, after, taught)
        if idle >= PATIENCE and gate == GATES[-1]:
            break
    return best, fault


def _lessons(
    model: CuboidModel, footage: Sequence[Frames], colors: ColorModel, gate: float
) -> tuple[list[Lesson], str]:
    """Return frames with confident poses whose faces have the hues of their names, or why too few do."""
    seen = []
    for one in footage:
        tracker = ObjectTracker(model, one.rig, colors)
        for images in one.learned:
            fit = tracker.fit(images)
            if isinstance(fit, Fit) and confidence(fit) >= gate:
                seen.append(lesson(model, one.rig, images, fit, colors))
    found = [one for one in seen if not misnamed(one.hues())]
    if len(found) >= FEW:
        return found, ""
    count, off = sum(len(one.learned) for one in footage), len(seen) - len(found)
    fault = f"found {len(found)} of {count} frames with a pose of confidence {gate:g} or more, expected {FEW}"
    hint = "are the object's size and faces right, and the images BGR?"
    if off:
        hint = f"in {off} more, the faces' hues do not match their names"
    return [], f"{fault}; {hint}; or use `tracker colors fit`"


def _told_wrong(hues: Mapping[int, float]) -> str:
    """Describe which faces do not have the hues of their names; empty if all do."""
    parts = [
        f"{COLOR_NAMES[label]} has the hue of {COLOR_NAMES[like] if like else 'grey'}"
        for label, like in misnamed(hues).items()
    ]
    hint = "against a coloured background, use `tracker colors fit`"
    return f"faces are mistaken for each other: {', '.join(parts)}; {hint}" if parts else ""


TRIED = 12
"""Approximate number of frames on which the models are compared."""


def nearest(model: CuboidModel, footage: Sequence[Frames], seed: int, normalise: bool = True) -> ColorModel:
    """Return the model that explains most of a few frames: the object's, a shipped one, or the names'."""
    step = max(1, sum(len(one.learned) for one in footage) // TRIED)
    few = [dataclasses.replace(one, learned=(), held_out=one.learned[::step]) for one in footage]
    names = [name for name in color_model_names() if name != "dice"]  # a single colour fits no cuboid
    models = [dataclasses.replace(from_names(seed), normalise=normalise)]
    for name in dict.fromkeys((model.colors, *names)):
        with suppress(ColorModelError):  # a new object has none yet
            models.append(dataclasses.replace(load_colors(name), normalise=normalise))
    return max(models, key=lambda colors: judge(model, few, colors).explained)


DRAWN = 40_000
"""Number of pixels drawn for each colour known only by its name."""

HUE_SPREAD = 12.0
"""Standard deviation of a paint's hue around that of its name [degrees]."""

LEVELS, SATURATIONS = (25.0, 255.0), (0.4, 1.0)
"""Ranges of the brightest channel and of the saturation from which pixels of a face are drawn."""

GREY = 0.25
"""Largest saturation of background pixels that are drawn."""


@functools.lru_cache(maxsize=1)
def from_names(seed: int) -> ColorModel:
    """Return a colour model that knows nothing but the names of the face colours.

    Face pixels are drawn around each name's hue, with any brightness and all but pale saturations;
    background pixels are nearly grey.
    """
    rng = np.random.default_rng([seed, 7])
    hues, greys, levels = (rng.uniform(0.0, most, 4 * DRAWN) for most in (360.0, GREY, 255.0))
    pixels = {0: bgr_of_hue(hues, greys, levels)}
    for label in range(1, CLASSES):
        hues = NAMED_HUES[label] + HUE_SPREAD * rng.standard_normal(DRAWN)
        pixels[label] = bgr_of_hue(hues, rng.uniform(*SATURATIONS, DRAWN), rng.uniform(*LEVELS, DRAWN))
    options = FitOptions(seed=seed)
    return combine([pixel_histograms(pixels, options, rng)], (), options, name="names")


GROUPS = 6
"""Number of groups of frames, each with the same weight."""

ENOUGH = 150
"""Smallest number of pixels, over all frames, from which a colour is learned."""

DISTRACTING = 0.2
"""Least share of background pixels whose colours were mistaken for a face, if any were; they are oversampled,
since a cross on the table fills only a thousandth of the images."""

MOST = 200_000
"""Largest number of background pixels kept per group."""


def learned(pixels: Sequence[Mapping[int, Array]]) -> dict[int, int]:
    """Return the number of pixels of each face colour that has enough to learn from."""
    counts = {label: sum(len(one.get(label, ())) for one in pixels) for label in range(1, CLASSES)}
    return {label: count for label, count in counts.items() if count >= ENOUGH}


def refit(
    pixels: Sequence[Mapping[int, Array]], taken: Array, before: Sequence[ColorModel], options: FitOptions
) -> ColorModel:
    """Fit a colour model to frames' pixels (N, 3) in neutral light by label, 0 for background.

    taken: (32³,) bool: colours that were mistaken for a face.
    before: earlier models; they get a small weight, except for face colours that the frames do not show.
    """
    rng = np.random.default_rng(options.seed)
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
    return combine(histograms, [_remembered(one) for one in before], options)


def _with_distracting(background: Array, taken: Array, rng: np.random.Generator) -> Array:
    """Resample background so that a share DISTRACTING or more has colours `taken` for a face, if any do."""
    distracting = background[taken[nodes_of(background)]]
    if len(background) > MOST:
        background = background[rng.integers(len(background), size=MOST)]
    if not len(distracting):
        return background
    more = round(DISTRACTING / (1.0 - DISTRACTING) * len(background))
    return np.concatenate([background, distracting[rng.integers(len(distracting), size=more)]])


def _remembered(model: ColorModel) -> Histograms:
    """Return densities of the face colours that a model knows, assuming a uniform distribution of all."""
    posterior = np.exp(model.log_posterior)
    posterior /= posterior.sum(axis=0)
    known = np.unique(np.argmax(posterior, axis=0))
    return {label: posterior[label] / posterior[label].sum() for label in range(1, CLASSES) if label in known}
