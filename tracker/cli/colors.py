"""`tracker colors`: learn colours from recordings or from labelled images, and measure them."""

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

import tracker
from tracker.cli import options
from tracker.cli.options import command, file_option, flag, option, several
from tracker.cli.outputs import InFile, OutFile, Recording
from tracker.cli.stills import silent_libraries
from tracker.cli.terminal import listing, table
from tracker.color_learning.adapt import Adapted
from tracker.color_learning.adapt import adapt as learn_colors
from tracker.color_learning.fit import FitOptions, combine, image_histograms
from tracker.color_learning.hues import LIGHT, NEAR, better_set, distances, paints
from tracker.color_learning.labelled import LabelledImage, confusion, intersection_over_union, read_labelled
from tracker.color_learning.lessons import FEWEST_FRAMES, Frames, frames_of, shares
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ColorModelError, ImageError
from tracker.files import write_whole
from tracker.objects.labels import COLOR_NAMES
from tracker.objects.model import face_labels_of, object_names, to_toml

WEAK = 0.9  # recall below which a colour is weak
FALSE = 0.1  # share of false pixels, among those found, above which a colour is weak
LABELS = range(1, len(COLOR_NAMES))


@click.group(no_args_is_help=False)
def colors() -> None:
    """Fit a colour model to recordings or to labelled images, and measure one.

    A FOLDER of labelled images holds NN_image.png with one mask for each colour that it shows,
    NN_mask_red.png, NN_mask_green.png and so on; or cameraNN.png with rNN.png, gNN.png, bNN.png, cNN.png,
    mNN.png, yNN.png. A mask's pixel counts where it is not black.
    """


@dataclass(frozen=True, kw_only=True)
class Learning:
    """Inputs and options for learning colours."""

    recordings: tuple[Path, ...] = several("RECORDING", Recording())
    output: Path = file_option("Colour model (.npz).", ".npz", required=True)
    cameras: options.Cameras
    frames: int = options.whole(
        "Frames to use, spread evenly, two or more of each recording; half of them only check.",
        default=80,
        least=10,
        most=2000,
    )
    rounds: int = options.whole("Most rounds.", default=8, most=50)
    seed: int = options.seed
    recover: bool = options.recover
    quiet: bool = flag("Print errors only.")

    def footage(self) -> list[Frames]:
        """Read frames from the recordings; TrackerError if that fails or there are too few."""
        lengths, found = [], 0
        result: list[Frames] = []
        for path in self.recordings:
            with tracker.open_log(path, recover=self.recover) as log:
                lengths.append(len(log))
        for path, count in zip(self.recordings, shares(lengths, self.frames), strict=True):
            with tracker.open_log(path, recover=self.recover) as log:
                result.append(frames_of(log, self.cameras.rig_of(path, log), count, found))
            found += len(result[-1].learned) + len(result[-1].held_out)
        if found < FEWEST_FRAMES:
            least = f"expected at least {FEWEST_FRAMES}"
            raise ColorModelError(f"recordings: found {found} frames with images, {least}")
        return result

    def learn(
        self, model: tracker.CuboidModel, start: tracker.ColorModel | None, first: bool = False
    ) -> None:
        """Learn colours from the frames and write the model; print one line per round. first: see `adapt`."""
        footage = self.footage()
        say: Callable[[str], None] = (lambda _: None) if self.quiet else click.echo
        draws = FitOptions(seed=self.seed)
        learned = learn_colors(model, footage, start, draws, rounds=self.rounds, first=first, say=say)
        learned.colors.save(self.output)
        if not self.quiet:
            click.echo(_learned(learned, self.output))


@command(colors)
def adapt(
    lesson: Learning,
    object_name: str = options.object_name(),
    colors_name: str | None = options.colors("start with the one that explains most"),
) -> None:
    """Fit a colour model to RECORDINGs of a known object, without labels.

    Confident poses show which pixels are of a face. Colours fitted to these find more poses, round by round.
    The other frames check the result. If they are explained no better, nothing is written, and the
    exit code is 1. On a coloured table, on which faces seem to have other hues, images are read as they are.

    Give the file to `--colors` of other commands, or name it in the object's TOML file.
    """
    model = tracker.load_object(object_name)
    start = tracker.load_colors(colors_name) if colors_name is not None else None
    lesson.learn(model, start)


@command(colors)
def new(
    lesson: Learning,
    size: tuple[float, float, float] | None = option(
        "X,Y,Z", "Edge lengths along the object's axes [m].", options.numbers(3)
    ),
    faces: str | None = option("+X=COLOUR,...", "Colour of each face, e.g. +x=red,-x=magenta,..."),
    known: str | None = option(
        "FILE", "The object's TOML file, if there is one.", InFile(str), name="--object"
    ),
) -> None:
    """Fit a colour model to RECORDINGs of a new object.

    Needs the object's size and the names of its colours. Starts with their hues, or with a model of the
    package if that explains more. Continues like `adapt`, but keeps the start if nothing is gained. Also
    writes the object's TOML file, unless --object gives one. Its path serves as an object's name.
    """
    description = lesson.output.with_suffix(".toml")
    if known is not None and (size is not None or faces is not None):
        raise click.UsageError("found --object with --size or --faces, expected one or the other")
    if known is None and os.path.lexists(description):
        raise click.UsageError(f"{description}: exists; expected --object to use it, or another -o")
    model = described(lesson.output, size, faces) if known is None else tracker.load_object(known)
    text = to_toml(model) if known is None else ""
    lesson.learn(model, None, first=True)
    if known is None:
        write_whole(description, text)
        if not lesson.quiet:
            click.echo(f"object   {description}")


def described(
    output: Path, size: tuple[float, float, float] | None, faces: str | None
) -> tracker.CuboidModel:
    """Return the object given by --size and --faces; its name and colours are those of the output."""
    if size is None or faces is None:
        raise click.UsageError("expected --size and --faces, or --object")
    if output.stem in object_names():
        raise click.UsageError(f"-o {output}: that is an object in the package, expected another name")
    colors: dict[str, str] = {}
    for part in faces.split(","):
        face, _, color = part.strip().partition("=")
        if face in colors:
            raise click.UsageError(f"--faces: {face} is given twice, expected each face once")
        colors[face] = color
    return tracker.CuboidModel(output.stem, np.array(size), face_labels_of(colors), output.name)


def _learned(learned: Adapted, output: Path) -> str:
    pixels, before = learned.pixels, learned.before
    kinds = table([["training pixels", *pixels], ["", *map(str, pixels.values())]])
    kept = [f"{color}: too few pixels, so it stays as it was" for color, count in pixels.items() if not count]
    if learned.after is before:
        kept = [f"no round was better: the colours stay those of {learned.colors.name}"]
    if not learned.colors.normalise:
        kept.append("for images as they are: keep exposure and white balance fixed")
    judged = ["before", f"{before} of {before.frames} held-out frames"], ["after", str(learned.after)]
    return "\n".join(["", kinds, *kept, "", listing([*judged, ["colours", str(output)]])])


_folders = several("FOLDER", Recording(str))


@dataclass(frozen=True)
class Fitting:
    """Options for fitting colours to labelled images."""

    others: tuple[str, ...] = option(
        "FOLDER",
        "Labelled images of other objects, for colours of which you have few; repeatable.",
        Recording(str),
        multiple=True,
    )
    rendered: bool = flag("The images come from a renderer with one light: take their colours as they are.")
    seed: int = options.seed

    def to(self, images: Sequence[LabelledImage]) -> Callable[[Sequence[int], str], tracker.ColorModel]:
        """Return a function that fits a model with a given name to the images with given indices."""
        draws, normalise = FitOptions(seed=self.seed), not self.rendered
        read = functools.partial(image_histograms, normalise=normalise)
        own = [read(image, draws) for image in images]
        theirs = [read(image, draws.for_others()) for image in _read(self.others)]

        def fit_to(chosen: Sequence[int], name: str) -> tracker.ColorModel:
            return combine([own[k] for k in chosen], theirs, draws, name=name, normalise=normalise)

        return fit_to


@command(colors)
def fit(
    *,
    folders: tuple[str, ...] = _folders,
    name: str | None = option("NAME", "Name of the model, if -o does not give its file."),
    output: Path | None = file_option("The model's file (.npz).  [default: NAME.npz]", ".npz"),
    fitting: Fitting,
) -> None:
    """Fit a colour model to the labelled images of the FOLDERs.

    Give its file to `tracker detect --colors`, or name it in the object's TOML file.
    """
    if output is None:
        if name is None:
            raise click.UsageError("found neither --name nor -o, expected one of them")
        output = Path(f"{name}.npz")
        OutFile(".npz").check("--name", output)
    images = _read(folders)
    model = fitting.to(images)(range(len(images)), output.stem)
    model.save(output)
    _print_counts(images, model)
    click.echo(f"\n{model.name}: written to {output}")


@command(colors)
def check(
    *,
    folders: tuple[str, ...] = _folders,
    name: str | None = option(
        "NAME", "The colour model to measure, or its file.", InFile(str), name="--colors"
    ),
    cross_validate: bool = flag("Measure each image with a fit to all others."),
    plot: Path | None = file_option(
        "Draw which colours are confused, and how near they are (.png).", ".png", extra="plot"
    ),
    fitting: Fitting,
) -> None:
    """Measure a colour model on the labelled images of the FOLDERs.

    Prints the intersection over union (0 to 1) of found and painted pixels. Masks that are a little too small
    keep it below 1. With --cross-validate, a colour that only one image shows needs --others.

    Also prints which colours are confused, how close they are to each other and to the light, and which
    colours would be easier to distinguish.
    """
    if (name is not None) == cross_validate:
        raise click.UsageError("expected either --colors NAME or --cross-validate")
    if not cross_validate and (fitting.others or fitting.rendered):
        raise click.UsageError("--others and --rendered are for --cross-validate")
    model = None if name is None else tracker.load_colors(name)
    images = _read(folders)
    if model is not None:
        models = [model] * len(images)
    elif len(images) < 2:
        raise ImageError(f"labelled images: found {len(images)}, expected at least 2 for --cross-validate")
    else:
        fit_to, numbers = fitting.to(images), range(len(images))
        models = [fit_to([k for k in numbers if k != left], "fitted") for left in numbers]
    found = [tracker.segment(one.image, model) for one, model in zip(images, models, strict=True)]
    _print_overlaps(images, found)
    counts = confusion((labels, one.labels) for labels, one in zip(found, images, strict=True))
    pixels, light = paints(images)
    means: dict[int, FloatArray] = {label: np.median(some, axis=0) for label, some in pixels.items()}
    better = better_set(means)
    _print_confusion(counts)
    _print_weak(counts)
    if means:  # the images do not show background only
        _print_near(means, better, light)
    if plot is not None:
        title = f"colours: {name or 'cross-validated'}"
        tracker.viz.write_colors_plot(plot, counts, pixels, better, title)
        click.echo(f"\nplot: {plot}")


def _read(folders: Sequence[str]) -> list[LabelledImage]:
    with silent_libraries():
        return [image for folder in folders for image in read_labelled(folder)]


def _print_counts(images: Sequence[LabelledImage], model: tracker.ColorModel) -> None:
    """Print the number of labelled pixels per image and colour, and colours that nothing taught."""
    counts = np.array([[np.count_nonzero(one.labels == label) for label in LABELS] for one in images])
    rows = [
        [one.name, *(str(count or "-") for count in row)] for one, row in zip(images, counts, strict=True)
    ]
    click.echo(table([["labelled pixels", *COLOR_NAMES[1:]], *rows]))
    for label, count in zip(LABELS, counts.sum(axis=0), strict=True):
        if not count and label not in model.label_table:
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
    return f"{sum(values) / len(values):.3f}" if values else "-"


def _print_confusion(counts: Array) -> None:
    rows = [["of the pixels of", *COLOR_NAMES[1:], "none"]]
    for label in [*LABELS, 0]:
        if total := counts[label].sum():
            shares = np.roll(counts[label], -1) / total
            rows.append([COLOR_NAMES[label], *(f"{100 * share:.2f} %" if share else "-" for share in shares)])
    click.echo(f"\nfound as\n{table(rows)}")


def _print_weak(counts: Array) -> None:
    weak = []
    others = np.where(np.eye(len(counts), dtype=bool), 0, counts)
    for label in filter(lambda label: counts[label].sum(), LABELS):
        name, right = COLOR_NAMES[label], counts[label, label]
        if (share := right / counts[label].sum()) < WEAK:
            taken = COLOR_NAMES[int(others[label].argmax())]
            weak.append(f"weak: {name}: {100 * share:.0f} % is found, most of the rest as {taken}")
        false = 1 - right / max(counts[:, label].sum(), 1)
        if false > FALSE and others[:, label].any():
            of = COLOR_NAMES[int(others[:, label].argmax())]
            weak.append(f"weak: {name}: {100 * false:.0f} % of what is found is something else, mostly {of}")
    click.echo("\n".join(["", *(weak or ["no colour is weak"])]))


def _print_near(means: dict[int, FloatArray], better: dict[int, FloatArray], light: FloatArray) -> None:
    far = distances(means)
    rows = [["distance to", *(COLOR_NAMES[label] for label in means), "the light"]]
    for a in means:
        cells = [f"{far[min(a, b), max(a, b)]:.1f}" if a != b else "-" for b in means]
        rows.append([COLOR_NAMES[a], *cells, f"{far[LIGHT, a]:.1f}"])
    blue, green, red = (100 * light).round().astype(int).tolist()
    click.echo(f"\nin standard deviations caused by light, shade and camera\n{table(rows)}")
    click.echo(f"the light: red {red} %, green {green} %, blue {blue} %")
    for (a, b), value in sorted(far.items(), key=lambda item: item[1]):
        if value < NEAR:
            other = "the light (the colour of grey things)" if a == LIGHT else COLOR_NAMES[a]
            click.echo(f"near: {COLOR_NAMES[b]} and {other}, {value:.1f}")
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
