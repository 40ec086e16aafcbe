"""`tracker colors`: fit a colour model to hand-labelled images, and measure one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli import learn, options
from tracker.cli.outputs import Command, InFile, OutFile, Recording, file_option, save_colors
from tracker.cli.pictures import silent_libraries
from tracker.cli.render import table
from tracker.errors import ImageError

if TYPE_CHECKING:
    from tracker.conventions import Array, FloatArray, Image
    from tracker.segmentation.hues import Paints
    from tracker.segmentation.labelled import LabelledImage

WEAK = 0.9
"""Share of a colour's pixels that are found below which it is weak."""

FALSE = 0.1
"""Share of the pixels found in a colour that are of no such face above which it is weak, too."""


def _print_confusion(counts: Array) -> None:
    from tracker.objects.labels import COLOR_NAMES

    rows = [["of the pixels of", *COLOR_NAMES[1:], "none"]]
    for label in [*range(1, len(COLOR_NAMES)), 0]:
        row = counts[label]
        if not row.sum():
            continue
        shares = [*row[1:], row[0]] / row.sum()
        rows.append([COLOR_NAMES[label], *(f"{share:.2%}" if share else "-" for share in shares)])
    click.echo(f"\nfound as\n{table(rows)}")


def _print_weak(counts: Array) -> None:
    """Colours whose pixels are not found, or whose name others get."""
    from tracker.objects.labels import COLOR_NAMES

    click.echo()
    weak = False
    for label in range(1, len(COLOR_NAMES)):
        row, column = counts[label].astype(float), counts[:, label].astype(float)
        if not row.sum():
            continue
        found = row[label] / row.sum()
        if found < WEAK:
            row[label] = 0
            taken = COLOR_NAMES[int(row.argmax())]
            click.echo(
                f"weak: {COLOR_NAMES[label]}, of which {found:.0%} is found; most of the rest as {taken}"
            )
            weak = True
        false = 1 - column[label] / column.sum() if column.sum() else 0.0
        if false > FALSE:
            column[label] = 0
            of = COLOR_NAMES[int(column.argmax())]
            click.echo(f"weak: {COLOR_NAMES[label]}; {false:.0%} of what is found as it is none, mostly {of}")
            weak = True
    if not weak:
        click.echo("no colour is weak")


def _print_near(paints: Paints) -> None:
    """How far apart the colours are, and which would be farther."""
    from tracker.objects.labels import COLOR_NAMES
    from tracker.segmentation.hues import LIGHT, NEAR, better_set, distances

    means = paints.means()
    far = distances(means)
    rows = [["distance to", *(COLOR_NAMES[label] for label in means), "the light"]]
    for a in means:
        cells = [f"{far[min(a, b), max(a, b)]:.1f}" if a != b else "-" for b in means]
        rows.append([COLOR_NAMES[a], *cells, f"{far[LIGHT, a]:.1f}"])
    blue, green, red = (100 * paints.light).round().astype(int).tolist()
    click.echo(f"\nin standard deviations of what light, shade and camera do to a colour\n{table(rows)}")
    click.echo(f"the light: red {red} %, green {green} %, blue {blue} %")
    for (a, b), value in sorted(far.items(), key=lambda item: item[1]):
        if value < NEAR:
            other = "the light, which is that of all that is grey" if a == LIGHT else COLOR_NAMES[a]
            click.echo(f"near: {COLOR_NAMES[b]} and {other}, {value:.1f}")
    better = better_set(means)
    gain = f"nearest {min(far.values()):.1f} -> {min(distances(better).values()):.1f}"
    click.echo(f"\na better set of colours, {gain}; red, green, blue where the picture's greys are at 115")
    click.echo(table(_set_rows(means, better)))


def _set_rows(means: Mapping[int, FloatArray], better: Mapping[int, FloatArray]) -> Sequence[Sequence[str]]:
    from tracker.objects.labels import COLOR_NAMES

    def rgb_levels(color: FloatArray) -> str:
        return " ".join(f"{round(level):3d}" for level in color[::-1].tolist())

    rows = [["", "now", "better"]]
    for label, mean in means.items():
        same = bool((mean == better[label]).all())
        rows.append([COLOR_NAMES[label], rgb_levels(mean), "stays" if same else rgb_levels(better[label])])
    return rows


_folders = click.argument("folders", nargs=-1, required=True, metavar="FOLDER...", type=Recording(str))
_others = click.option(
    "--others",
    multiple=True,
    metavar="FOLDER",
    type=InFile(str),
    help="Labelled images of other objects, which help a little; repeatable.",
)
_rendered = click.option(
    "--rendered",
    is_flag=True,
    help="The images come from a renderer with one light: take their colours as they are.",
)


@click.group(no_args_is_help=False, short_help="Fit, learn and check the colours of objects.")
def colors() -> None:
    """Fit a colour model to labelled images, and measure one.

    A FOLDER of labelled images holds NN_image.png with one mask for each colour that it shows,
    NN_mask_red.png, NN_mask_green.png and so on; or cameraNN.png with rNN.png, gNN.png, bNN.png, cNN.png,
    mNN.png, yNN.png. A mask's pixel counts where it is not black.
    """


colors.add_command(learn.adapt)
colors.add_command(learn.new)


@colors.command(cls=Command)
@_folders
@click.option("--name", metavar="NAME", help="Name of the model.  [default: that of the file]")
@file_option("-o", ".npz", help="The model's file (.npz).  [default: NAME.npz]")
@_others
@_rendered
@options.seed
def fit(
    folders: tuple[str, ...],
    name: str | None,
    output: Path | None,
    others: tuple[str, ...],
    rendered: bool,
    seed: int,
) -> None:
    """Fit a colour model to the labelled images of the FOLDERs.

    Then give its file to `tracker detect --colors`, or name it in the object's TOML file.
    """
    if output is None:
        if name is None:
            raise click.UsageError("found neither --name nor -o, expected one of them")
        output = Path(f"{name}.npz")
        OutFile(".npz").check("--name", output)
    images = _read(folders)
    model = _fitter(images, _read(others), rendered, seed)(range(len(images)), name or output.stem)
    save_colors(model, output)
    _print_counts(images)
    click.echo(f"\n{model.name}: written to {output}")


@colors.command(cls=Command)
@_folders
@click.option(
    "--colors",
    "colors_name",
    metavar="NAME",
    type=InFile(str),
    help="Measure this colour model, or that of this file.",
)
@click.option(
    "--cross-validate", is_flag=True, help="Measure a fit: on each image, fitted to all the others."
)
@file_option(
    "--plot", ".png", extra="plot", help="Draw what is taken for what, and how near the colours are (.png)."
)
@_others
@_rendered
@options.seed
def check(
    folders: tuple[str, ...],
    colors_name: str | None,
    cross_validate: bool,
    plot: Path | None,
    others: tuple[str, ...],
    rendered: bool,
    seed: int,
) -> None:
    """Measure a colour model on the labelled images of the FOLDERs.

    Prints the intersection over union, from 0 to 1, of the pixels found in each colour and its mask.
    Masks drawn a little too small keep it below 1. A colour that a single image shows is unknown to a
    fit without that image, unless --others show it.

    Then it says which colours are taken for which, how near they are to each other and to the light, and
    which colours would be farther apart.
    """
    if (colors_name is not None) == cross_validate:
        raise click.UsageError("expected either --colors NAME or --cross-validate")
    if not cross_validate and (others or rendered):
        raise click.UsageError("--others and --rendered are for --cross-validate")
    if colors_name is not None:
        model = tracker.load_colors(colors_name)
        images = _read(folders)
        models = [model] * len(images)
    else:
        images = _read(folders)
        if len(images) < 2:
            found = f"found {len(images)}, expected at least 2 for --cross-validate"
            raise ImageError(f"labelled images: {found}")
        fitted = _fitter(images, _read(others), rendered, seed)
        rest = [[k for k in range(len(images)) if k != left] for left in range(len(images))]
        models = [fitted(chosen, "fitted") for chosen in rest]
    _report(images, models, plot, colors_name or "cross-validated")


def _report(
    images: Sequence[LabelledImage], models: Sequence[tracker.ColorModel], plot: Path | None, name: str
) -> None:
    """Measure each image by its model, print and draw."""
    from tracker.segmentation.hues import better_set, paints
    from tracker.segmentation.labelled import confusion

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


def _read(folders: Sequence[str]) -> list[LabelledImage]:
    from tracker.segmentation.labelled import read_labelled

    with silent_libraries():
        return [image for folder in folders for image in read_labelled(folder)]


def _fitter(
    images: Sequence[LabelledImage], others: Sequence[LabelledImage], rendered: bool, seed: int
) -> Callable[[Sequence[int], str], tracker.ColorModel]:
    """A function that fits a model of some name to those of the images whose indices are given."""
    from tracker.segmentation.fit import FitOptions, combine, image_histograms

    draws = FitOptions(seed=seed)
    own = [image_histograms(image, draws, normalise=not rendered) for image in images]
    theirs = [image_histograms(image, draws, normalise=not rendered) for image in others]

    def fit_to(chosen: Sequence[int], name: str) -> tracker.ColorModel:
        return combine([own[k] for k in chosen], theirs, draws, name=name, normalise=not rendered)

    return fit_to


def _print_counts(images: Sequence[LabelledImage]) -> None:
    """Labelled pixels of each image and colour, and the colours of which there are none."""
    from tracker.objects.labels import COLOR_NAMES

    rows = [["labelled pixels", *COLOR_NAMES[1:]]]
    for image in images:
        counts = [int((image.labels == label).sum()) for label in range(1, len(COLOR_NAMES))]
        rows.append([image.name, *(str(count) if count else "-" for count in counts)])
    click.echo(table(rows))
    for color, *cells in zip(*rows, strict=True):
        if all(cell == "-" for cell in cells):
            click.echo(f"no image shows {color}: the model will not find it")


def _print_overlaps(images: Sequence[LabelledImage], found: Sequence[Image]) -> None:
    """Intersection over union of each image and colour, and the means."""
    from tracker.objects.labels import COLOR_NAMES
    from tracker.segmentation.labelled import intersection_over_union

    labels = range(1, len(COLOR_NAMES))
    overlaps = [
        intersection_over_union(labels_found, image.labels)
        for image, labels_found in zip(images, found, strict=True)
    ]
    rows = [["intersection over union", *COLOR_NAMES[1:], "mean"]]
    for image, overlap in zip(images, overlaps, strict=True):
        rows.append(
            [
                image.name,
                *(_shown([overlap[k]] if k in overlap else []) for k in labels),
                _shown(overlap.values()),
            ]
        )
    columns = [[overlap[k] for overlap in overlaps if k in overlap] for k in labels]
    everything = [value for column in columns for value in column]
    rows.append(["mean", *(_shown(column) for column in columns), _shown(everything)])
    click.echo(table(rows))


def _shown(values: Iterable[float]) -> str:
    """The mean; a dash where there is nothing."""
    numbers = list(values)
    return f"{sum(numbers) / len(numbers):.3f}" if numbers else "-"
