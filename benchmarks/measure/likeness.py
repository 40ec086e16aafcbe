"""Similarity of real and synthetic images: `python -m benchmarks likeness [--real FOLDER]`.

A colour table fitted to synthetic images alone segments the real, hand-labelled ones, and the shipped table,
fitted to those, segments the synthetic ones. Hand-made masks omit a face's rim, whose pixels mix two
surfaces, and so does the segmentation of large images. A rim of 1 px is therefore removed from the labels of
synthetic images, too, unless the table says `exact labels`.
"""

from collections.abc import Sequence
from pathlib import Path

import click
import cv2
import numpy as np

import tracker
from benchmarks.data.recorded import SEGMENTED, labelled_images, real_folder
from synthetic.frames import frames
from tracker.color_learning.fit import FitOptions, combine, image_histograms
from tracker.color_learning.labelled import LabelledImage, intersection_over_union
from tracker.conventions import Image
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.color_model import ColorModel

SEED = 90210
"""Seed of the synthetic images; not the one for which colours and light were tuned."""

RECORDED = {"cuboid_2x2x8_v2": (270, "old")}
"""Size [px] and path of an object's real images, where they are not (540, "new")."""

MIN_FACE = {"cuboid_2x2x8_v2": 0.0005}
MIN_FACE_OF_CUBES = 0.002
"""Smallest share of the image that a face must cover to count; few labelled faces are smaller."""

TARGETS = {"shipped → synthetic": 0.85, "shipped → synthetic, exact labels": None, "synthetic → real": 0.75}
"""Target mean IoU of each table on the images; None: no target."""

FIT = FitOptions(draws=10_000)
"""Options for fitting to synthetic images: fewer draws per image than for the few real images."""


def synthetic_images(name: str, scenes: int, quality: str) -> list[LabelledImage]:
    """Return images of all cameras with their exact labels."""
    result = []
    size, path = RECORDED.get(name, (540, "new"))
    for frame in frames(name, scenes, SEED, quality=quality, empty=0.0, size=size, path=path):
        pairs = zip(frame.images, frame.labels, strict=True)
        result += [LabelledImage(f"{name}/{frame.index}/{c}", *pair) for c, pair in enumerate(pairs)]
    return result


def synthetic_table(images: Sequence[LabelledImage], name: str) -> ColorModel:
    """Fit a colour table to synthetic images alone; their labels lose their rims, as hand-made masks do."""
    own = []
    for image in images:
        labels = _without_rims(image.labels)
        if (labels > 0).any():
            own.append(image_histograms(LabelledImage(image.name, image.image, labels), FIT))
    return combine(own, (), FIT, name=name)


def _without_rims(labels: Image) -> Image:
    result = np.zeros_like(labels)
    for label in range(1, 7):
        own = cv2.erode((labels == label).astype(np.uint8), np.ones((3, 3), np.uint8))
        result[own > 0] = label
    return result


def scores(images: Sequence[LabelledImage], colors: ColorModel, least: float = 0) -> list[tuple[int, float]]:
    """Return label and IoU of every face that covers at least a share `least` of its image."""
    result = []
    for image in images:
        found = intersection_over_union(tracker.segment(image.image, colors), image.labels)
        counts = np.bincount(image.labels.ravel(), minlength=7)
        result += [
            (label, value) for label, value in found.items() if counts[label] >= least * image.labels.size
        ]
    return result


def _row(subject: str, pair: str, values: list[tuple[int, float]]) -> str:
    limit = "" if TARGETS[pair] is None else f" (≥ {TARGETS[pair]})"
    ious = np.array([value for _, value in values])
    colors = []
    for label in range(1, 7):
        own = [value for key, value in values if key == label]
        colors.append(f"{COLOR_NAMES[label]} {np.mean(own):.2f}" if own else f"{COLOR_NAMES[label]} -")
    return f"| {subject}: {pair} | {len(ious)} | {ious.mean():.3f}{limit} | {', '.join(colors)} |"


def likeness_table(real: Path, scenes: int, quality: str) -> str:
    """Return a table of the IoUs for each object and over all faces."""
    rows = ["| table → pictures | faces | IoU, mean over faces (target) | by colour |", "|---|---|---|---|"]
    total: dict[str, list[tuple[int, float]]] = {pair: [] for pair in TARGETS}
    for name in SEGMENTED:
        made = synthetic_images(name, scenes, quality)
        least = MIN_FACE.get(name, MIN_FACE_OF_CUBES)
        shipped = tracker.load_colors(name)
        like_masks = [LabelledImage(i.name, i.image, _without_rims(i.labels)) for i in made]
        found = (
            scores(like_masks, shipped, least),
            scores(made, shipped, least),
            scores(labelled_images(real, name), synthetic_table(made, name)),
        )
        for pair, values in zip(TARGETS, found, strict=True):
            rows.append(_row(name, pair, values))
            total[pair] += values
    return "\n".join([*rows, *(_row("all", pair, values) for pair, values in total.items())])


@click.command()
@click.option("--real", type=click.Path(file_okay=False, path_type=Path), help="Folder of recorded data.")
@click.option(
    "--scenes",
    type=click.IntRange(min=1),
    default=40,
    show_default=True,
    help="Synthetic scenes of each object.",
)
@click.option(
    "--quality", default="default", show_default=True, help="Rendering quality of the synthetic pictures."
)
def main(real: Path | None, scenes: int, quality: str) -> None:
    """Print how similar the synthetic pictures are to real ones."""
    folder = real_folder(real)
    if folder is None:
        raise click.UsageError("--real: found no such folder, expected one of recorded data")
    click.echo(f"{scenes} scenes an object, three cameras, sizes as recorded, quality {quality}, seed {SEED}")
    least = 100 * MIN_FACE_OF_CUBES, 100 * MIN_FACE["cuboid_2x2x8_v2"]
    click.echo(f"synthetic faces of at least {least[0]:g} % (cuboid {least[1]:g} %) of the picture")
    click.echo(likeness_table(folder, scenes, quality))
