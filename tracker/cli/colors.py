"""`tracker colors`: fit a colour model to hand-labelled images, and measure one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli import learn, options
from tracker.cli.outputs import Command, InFile, OutFile, Recording, file_option, save_colors
from tracker.cli.pictures import silent_libraries
from tracker.errors import ImageError

if TYPE_CHECKING:
    from tracker.segmentation.labelled import LabelledImage

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
    from tracker.cli.colors_report import print_counts

    if output is None:
        if name is None:
            raise click.UsageError("found neither --name nor -o, expected one of them")
        output = Path(f"{name}.npz")
        OutFile(".npz").check("--name", output)
    images = _read(folders)
    model = _fitter(images, _read(others), rendered, seed)(range(len(images)), name or output.stem)
    save_colors(model, output)
    print_counts(images)
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
    from tracker.cli.colors_report import report

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
            raise ImageError(
                f"labelled images: found {len(images)}, expected at least 2 for --cross-validate"
            )
        fitted = _fitter(images, _read(others), rendered, seed)
        rest = [[k for k in range(len(images)) if k != left] for left in range(len(images))]
        models = [fitted(chosen, "fitted") for chosen in rest]
    report(images, models, plot, colors_name or "cross-validated")


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
