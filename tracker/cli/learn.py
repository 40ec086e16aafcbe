"""`tracker colors adapt` and `tracker colors new`: colours learned from recordings without labels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tracker.cli.options import (
    Cameras,
    Vector,
    calibration_options,
    colors_option,
    object_option,
    quiet_option,
    recover_option,
    rig_of,
    together,
)
from tracker.cli.outputs import Command, InFile, OutFile, Recording, save_colors
from tracker.cli.render import listing, table
from tracker.errors import ColorModelError

if TYPE_CHECKING:
    from tracker.color_learning.adapt import Adapted
    from tracker.color_learning.frames import Frames
    from tracker.objects.model import CuboidModel
    from tracker.segmentation.color_model import ColorModel

_Command = TypeVar("_Command", bound=Callable[..., Any])

_learning_options = together(
    click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...", type=Recording()),
    click.option(
        "-o", "--output", required=True, metavar="FILE", type=OutFile(".npz"), help="Colour model (.npz)."
    ),
    calibration_options,
    click.option(
        "--frames",
        metavar="N",
        type=click.IntRange(10, 2000),
        default=80,
        show_default=True,
        help="Frames that are looked at, spread evenly; half of them only judge.",
    ),
    click.option(
        "--rounds", metavar="N", type=click.IntRange(1, 50), default=8, show_default=True, help="Most turns."
    ),
    click.option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the fit's draws."
    ),
    recover_option,
    quiet_option(),
)


@click.command(cls=Command)
@_learning_options
@object_option()
@colors_option("the one of these that explains most, to begin with")
def adapt(
    recordings: tuple[Path, ...],
    output: Path,
    cameras: Cameras,
    frames: int,
    rounds: int,
    seed: int,
    recover: bool,
    quiet: bool,
    object_name: str,
    colors_name: str | None,
) -> None:
    """Fit a colour model to RECORDINGs of a known object, without labels.

    Where poses are sure, they say what is a face. The colours fitted to that find more poses, round by
    round; frames that did not teach decide whether they are better. If they are not, nothing is written,
    and the exit code is 1.

    Then give the file to `--colors` of other commands, or name it in the object's TOML file.
    """
    from tracker.color_learning.models import nearest
    from tracker.objects.model import load_object
    from tracker.segmentation.color_model import load_colors

    model = load_object(object_name)
    start = load_colors(colors_name) if colors_name is not None else None
    footage = read_footage(recordings, cameras, frames, recover)
    learned = learn(model, footage, start or nearest(model, footage), output, rounds, seed, quiet)
    write_colors(learned, output, quiet)


@click.command(cls=Command)
@_learning_options
@click.option("--size", metavar="X,Y,Z", type=Vector(3), help="Edge lengths along the object's axes [m].")
@click.option("--faces", metavar="+X=COLOUR,...", help="Colour of each face, e.g. +x=red,-x=magenta,...")
@click.option(
    "--object",
    "object_name",
    metavar="FILE",
    type=InFile(str),
    help="The object's TOML file, if there is one.",
)
def new(
    recordings: tuple[Path, ...],
    output: Path,
    cameras: Cameras,
    frames: int,
    rounds: int,
    seed: int,
    recover: bool,
    quiet: bool,
    size: tuple[float, float, float] | None,
    faces: str | None,
    object_name: str | None,
) -> None:
    """Fit a colour model to RECORDINGs of a new object, of which only size and names of colours are known.

    It begins with the hues that the names promise, and goes on as `adapt` does. Beside the colour model
    it writes the object's TOML file, unless --object gives one; its path then stands wherever an object's
    name does.
    """
    from tracker.color_learning.models import from_names
    from tracker.files import write_whole
    from tracker.objects.model import load_object, to_toml

    description = output.with_suffix(".toml")
    if object_name is not None and (size is not None or faces is not None):
        raise click.UsageError("found --object with --size or --faces, expected one or the other")
    if object_name is None and description.exists():
        raise click.UsageError(f"{description}: found already, and not to be overwritten; expected --object")
    model = load_object(object_name) if object_name is not None else described(output, size, faces)
    footage = read_footage(recordings, cameras, frames, recover)
    learned = learn(model, footage, from_names(seed), output, rounds, seed, quiet)
    write_colors(learned, output, quiet)
    if object_name is None:
        write_whole(description, to_toml(model))
        if not quiet:
            click.echo(f"object   {description}")


def described(output: Path, size: tuple[float, float, float] | None, faces: str | None) -> CuboidModel:
    """The object of the options --size and --faces, with the name and the colours of the output.

    Raises:
        click.UsageError: an option is missing, or a face is given twice.
        ObjectModelError: it is no object.
    """
    import numpy as np

    from tracker.objects.model import CuboidModel, face_labels_of

    if size is None or faces is None:
        raise click.UsageError("expected --size and --faces, or --object")
    pairs = [part.strip().partition("=") for part in faces.split(",")]
    doubled = sorted({face for face, _, _ in pairs if sum(face == other for other, _, _ in pairs) > 1})
    if doubled:
        raise click.UsageError(f"--faces: {doubled[0]} is given twice, expected each face once")
    labels = face_labels_of({face: color for face, _, color in pairs})
    return CuboidModel(output.stem, np.array(size), labels, output.name)


def read_footage(recordings: Sequence[Path], cameras: Cameras, frames: int, recover: bool) -> list[Frames]:
    """Frames of the recordings, about `frames` in all.

    Raises:
        TrackerError: a recording or its calibration cannot be read, or there are too few frames.
    """
    from tracker.color_learning.frames import LEAST, frames_of, shares
    from tracker.logs import open_log

    lengths = []
    for path in recordings:
        with open_log(path, recover=recover) as log:
            lengths.append(len(log))
    result = []
    for path, count in zip(recordings, shares(lengths, frames), strict=True):
        with open_log(path, recover=recover) as log:
            result.append(frames_of(log, rig_of(path, log, cameras), count))
    found = sum(len(one.learned) + len(one.held_out) for one in result)
    if found < LEAST:
        raise ColorModelError(f"recordings: found {found} frames with images, expected at least {LEAST}")
    return result


def learn(
    model: CuboidModel,
    footage: Sequence[Frames],
    start: ColorModel,
    output: Path,
    rounds: int,
    seed: int,
    quiet: bool,
) -> Adapted:
    """What the frames teach; each round is told in a line."""
    from tracker.color_learning.adapt import adapt as learn_colors
    from tracker.segmentation.fit import FitOptions

    say: Callable[[str], None] = (lambda _: None) if quiet else click.echo
    options = FitOptions(seed=seed)
    return learn_colors(model, footage, start, options, name=output.stem, rounds=rounds, say=say)


def write_colors(learned: Adapted, output: Path, quiet: bool) -> None:
    """Write the colour model, and tell what it is made of."""
    save_colors(learned.colors, output)
    if quiet:
        return
    click.echo()
    click.echo(table([["pixels that taught", *learned.pixels], ["", *map(str, learned.pixels.values())]]))
    for color, count in learned.pixels.items():
        if not count:
            click.echo(f"{color} was hardly seen: it stays as it was before")
    click.echo()
    judged = f"{learned.before} of {learned.before.frames} frames that did not teach"
    click.echo(listing([["before", judged], ["after", str(learned.after)], ["colours", str(output)]]))
