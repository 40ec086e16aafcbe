"""Reports on colour models, printed by `tracker colors`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

import tracker
from tracker.cli.terminal import table
from tracker.color_learning.hues import LIGHT, NEAR, Paints, better_set, distances, paints
from tracker.color_learning.labelled import LabelledImage, confusion, intersection_over_union
from tracker.conventions import Array, FloatArray, Image
from tracker.objects.labels import COLOR_NAMES

WEAK = 0.9  # recall below which a colour is weak
FALSE = 0.1  # share of false pixels, among those found, above which a colour is weak
LABELS = range(1, len(COLOR_NAMES))


def report(
    images: Sequence[LabelledImage], models: Sequence[tracker.ColorModel], plot: Path | None, name: str
) -> None:
    """Measure each image with its model, print the results, and draw them if `plot` is given."""
    found = [tracker.segment(one.image, model) for one, model in zip(images, models, strict=True)]
    _print_overlaps(images, found)
    counts = confusion((labels, one.labels) for labels, one in zip(found, images, strict=True))
    shown = paints(images)
    _print_confusion(counts)
    _print_weak(counts)
    _print_near(shown)
    if plot is not None:
        better = better_set(shown.means())
        tracker.viz.write_colors_plot(plot, counts, shown.pixels, better, f"colours: {name}")
        click.echo(f"\nplot: {plot}")


def print_counts(images: Sequence[LabelledImage]) -> None:
    """Print the number of labelled pixels per image and colour, and colours without any."""
    counts = np.array([[np.count_nonzero(one.labels == label) for label in LABELS] for one in images])
    rows = [
        [one.name, *(str(count or "-") for count in row)] for one, row in zip(images, counts, strict=True)
    ]
    click.echo(table([["labelled pixels", *COLOR_NAMES[1:]], *rows]))
    for label, count in zip(LABELS, counts.sum(axis=0), strict=True):
        if not count:
            click.echo(f"no image shows {COLOR_NAMES[label]}: the model will not find it")


def _print_overlaps(images: Sequence[LabelledImage], found: Sequence[Image]) -> None:
    overlaps = [intersection_over_union(one, image.labels) for one, image in zip(found, images, strict=True)]
    rows = [["intersection over union", *COLOR_NAMES[1:], "mean"]]
    named = [(image.name, [overlap]) for image, overlap in zip(images, overlaps, strict=True)]
    for name, its in (*named, ("mean", overlaps)):
        columns = [[overlap[k] for overlap in its if k in overlap] for k in LABELS]
        rows.append([name, *map(_mean, columns), _mean([value for column in columns for value in column])])
    click.echo(table(rows))


def _mean(values: Sequence[float]) -> str:
    """Format the mean; a dash if there are no values."""
    return f"{sum(values) / len(values):.3f}" if values else "-"


def _print_confusion(counts: Array) -> None:
    rows = [["of the pixels of", *COLOR_NAMES[1:], "none"]]
    for label in [*LABELS, 0]:
        if total := counts[label].sum():
            shares = np.roll(counts[label], -1) / total
            rows.append([COLOR_NAMES[label], *(f"{share:.2%}" if share else "-" for share in shares)])
    click.echo(f"\nfound as\n{table(rows)}")


def _print_weak(counts: Array) -> None:
    weak = []
    others = np.where(np.eye(len(counts), dtype=bool), 0, counts)
    for label in filter(lambda label: counts[label].sum(), LABELS):
        name, right = COLOR_NAMES[label], counts[label, label]
        if (share := right / counts[label].sum()) < WEAK:
            taken = COLOR_NAMES[int(others[label].argmax())]
            weak.append(f"weak: {name}: {share:.0%} is found, most of the rest as {taken}")
        false = 1 - right / max(counts[:, label].sum(), right, 1)
        if false > FALSE and others[:, label].any():
            of = COLOR_NAMES[int(others[:, label].argmax())]
            weak.append(f"weak: {name}: {false:.0%} of the pixels found are something else, mostly {of}")
    click.echo("\n".join(["", *(weak or ["no colour is weak"])]))


def _print_near(shown: Paints) -> None:
    means = shown.means()
    if not means:  # the images show background only
        return
    far = distances(means)
    rows = [["distance to", *(COLOR_NAMES[label] for label in means), "the light"]]
    for a in means:
        cells = [f"{far[min(a, b), max(a, b)]:.1f}" if a != b else "-" for b in means]
        rows.append([COLOR_NAMES[a], *cells, f"{far[LIGHT, a]:.1f}"])
    blue, green, red = (100 * shown.light).round().astype(int).tolist()
    click.echo(f"\nin standard deviations caused by light, shade and camera\n{table(rows)}")
    click.echo(f"the light: red {red} %, green {green} %, blue {blue} %")
    for (a, b), value in sorted(far.items(), key=lambda item: item[1]):
        if value < NEAR:
            other = "the light (the colour of grey things)" if a == LIGHT else COLOR_NAMES[a]
            click.echo(f"near: {COLOR_NAMES[b]} and {other}, {value:.1f}")
    better = better_set(means)
    gain = f"nearest {min(far.values()):.1f} -> {min(distances(better).values()):.1f}"
    click.echo(f"\na better set of colours, {gain}; as red, green, blue, with greys at 115")
    rows = [["", "now", "better"]]
    for label, mean in means.items():
        new = "stays" if bool((mean == better[label]).all()) else _levels(better[label])
        rows.append([COLOR_NAMES[label], _levels(mean), new])
    click.echo(table(rows))


def _levels(color: FloatArray) -> str:
    """Format a BGR colour as red, green and blue."""
    return " ".join(f"{round(level):3d}" for level in color[::-1].tolist())
