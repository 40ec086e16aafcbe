"""Fit a colour model to hand-labelled images.

Few images are ever labelled, and each shows a face under one light. So labelled pixels are drawn many
times with jitter of brightness (other shading) and between channels (imperfect white balance), with
haze (gloss, veiling glare) and noise. A fifth of the draws have wider jitter and purer tones, which covers
colours between and around the observed ones that nothing else claims. Half of the draws are also shaded
and veiled: a face turned away from the lamps reflects less light in its own colour, and its gloss adds grey
light from the surroundings. The draws make one histogram per image and class; histograms are averaged so
that each image counts the same. Other objects' images count a little, too, and more if few of the object's
own show a colour. Their paints differ, so the tints of their draws vary much more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from tracker.color_learning.labelled import LabelledImage, neutral, surely_background
from tracker.conventions import Array, FloatArray
from tracker.errors import ImageError
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel, compand


@dataclass(frozen=True)
class FitOptions:
    """Assumed variation of light and camera, and weights of the fit."""

    brightness: float = 0.25
    """Standard deviation of the log of a face's brightness."""
    channel: float = 0.04
    """Standard deviation of the log of each channel's gain."""
    haze: float = 8.0
    """Standard deviation of a level added to all three channels [levels]."""
    noise: float = 3.0
    """Standard deviation of each channel's noise [levels]."""
    tail_share: float = 0.2
    """Share of draws with purer tones and wider jitter, the tail."""
    tail_width: float = 2.0
    """Factor on the jitter between channels in the tail; on that of brightness and haze, at most 2."""
    others_width: float = 12.0
    """The same factor for other objects' images, whose paints differ."""
    tail_stretch: float = 2.0
    """Largest factor on the saturation in the tail: a purer tone of a hue is the same colour."""
    shaded_share: float = 0.5
    """Share of draws that become s · draw + (1 − s) · veil: shaded, and under a grey veil."""
    shade: float = 0.3
    """Smallest s of shaded draws, uniform up to 1."""
    veil: float = 150.0
    """Largest level of the veil, uniform from 0 [levels]."""
    draws: int = 60000
    """Number of draws per image and class; four times as many for background."""
    others_weight: float = 0.2
    """Total weight of other objects' images in the density of a face colour; an own image has weight 1."""
    reject: float = 0.01
    """Share of the background's density that is uniform over all colours."""
    face_prior: float = 0.08
    """Prior probability of each face colour; wrong pixels are removed later by their shape."""
    smoothing: float = 0.4
    """Standard deviation of the smoothing of the histograms [nodes]."""
    seed: int = 0

    def for_others(self) -> FitOptions:
        """Return the options with which other objects' images are drawn."""
        return replace(self, tail_width=self.others_width)


BACKGROUND_JITTER = FitOptions(
    brightness=0.12, channel=0.03, haze=2.0, noise=2.0, tail_share=0.0, shaded_share=0.0
)

Histograms = dict[int, FloatArray]
"""Density over the nodes, by label."""


def _histogram(levels: FloatArray) -> FloatArray:
    """Return the density (32, 32, 32) of levels (N, 3), each distributed over its eight nearest nodes."""
    position = compand(levels, NODES)
    base = np.minimum(position.astype(np.int64), NODES - 2)
    part = position - base
    total = np.zeros(NODES**3)
    for corner in range(8):
        offset = np.array([corner & 1, corner >> 1 & 1, corner >> 2 & 1])
        weight = np.prod(np.where(offset == 1, part, 1 - part), axis=1)
        index = np.ravel_multi_index((base + offset).T, (NODES,) * 3)
        total += np.bincount(index, weights=weight, minlength=total.size)
    return (total / len(levels)).reshape((NODES,) * 3)


def _draw(pixels: Array, count: int, jitter: FitOptions, rng: np.random.Generator) -> FloatArray:
    chosen = pixels[rng.integers(len(pixels), size=count)] + rng.uniform(-0.5, 0.5, (count, 3))
    tail = rng.uniform(size=(count, 1)) < jitter.tail_share
    wide = np.where(tail, jitter.tail_width, 1.0)
    wide2 = np.minimum(wide, 2.0)
    grey = np.exp(np.log(chosen + 2.0).mean(axis=1, keepdims=True))
    stretch = np.where(tail, rng.uniform(1.0, jitter.tail_stretch, (count, 1)), 1.0)
    chosen = np.where(tail, grey * ((chosen + 2.0) / grey) ** stretch - 2.0, chosen)
    light = rng.normal(0, jitter.brightness, (count, 1)) * wide2
    balance = rng.normal(0, jitter.channel, (count, 3)) * wide
    added = rng.normal(0, jitter.haze, (count, 1)) * wide2 + rng.normal(0, jitter.noise, (count, 3))
    if jitter.shaded_share > 0:
        shaded = rng.uniform(size=(count, 1)) < jitter.shaded_share
        left = np.where(shaded, rng.uniform(jitter.shade, 1, (count, 1)), 1.0)
        chosen = left * chosen + (1 - left) * rng.uniform(0, jitter.veil, (count, 1))
    return np.clip(chosen * np.exp(light + balance) + added, 0, 255)


def image_histograms(labelled: LabelledImage, options: FitOptions, normalise: bool = True) -> Histograms:
    """Return histograms of the classes in one image; background pixels keep a distance from the labels."""
    rng = np.random.default_rng([options.seed, *labelled.name.encode(errors="surrogatepass")])
    image = neutral(labelled.image)[0] if normalise else labelled.image
    shown = np.unique(labelled.labels[labelled.labels > 0])
    pixels = {int(label): image[labelled.labels == label] for label in shown}
    background = image[surely_background(labelled.labels)]
    if not len(background):
        what = f"labelled image {labelled.name}"
        raise ImageError(f"{what}: found masks that leave no background, expected some")
    return pixel_histograms({**pixels, 0: background}, options, rng)


def pixel_histograms(
    pixels: Mapping[int, Array], options: FitOptions, rng: np.random.Generator
) -> Histograms:
    """Return histograms of classes from their pixels (N, 3) by label, N > 0; 0: background."""
    background, face = (4 * options.draws, BACKGROUND_JITTER), (options.draws, options)
    return {
        label: _histogram(_draw(some, *(face if label else background), rng))
        for label, some in pixels.items()
    }


def combine(
    own: Sequence[Histograms],
    others: Sequence[Histograms] = (),
    options: FitOptions | None = None,
    *,
    name: str = "fitted",
    normalise: bool = True,
) -> ColorModel:
    """Make a colour model from histograms of the object's own images and of other objects' images."""
    options = options or FitOptions()
    uniform = _histogram(np.random.default_rng(options.seed).uniform(0, 1, (400000, 3)) ** 2 * 255)
    density = np.zeros((CLASSES, NODES, NODES, NODES))
    for label in range(CLASSES):
        mine = [h[label] for h in own if label in h]
        theirs = [h[label] for h in others if label in h]
        share = options.others_weight / (len(mine) + options.others_weight) if label else 0.5
        if mine and theirs:
            density[label] = (1 - share) * np.mean(mine, axis=0) + share * np.mean(theirs, axis=0)
        elif mine or theirs:
            density[label] = np.mean(mine or theirs, axis=0)
    density[0] = (1 - options.reject) * density[0] + options.reject * uniform
    prior = np.full(CLASSES, options.face_prior)
    prior[0] = 1 - options.face_prior * (CLASSES - 1)
    smooth = np.stack([gaussian_filter(d, options.smoothing, mode="nearest") for d in density])
    log_posterior = np.log((smooth + 1e-9) * prior[:, None, None, None])
    return ColorModel(name, log_posterior - log_posterior.max(axis=0), normalise)
