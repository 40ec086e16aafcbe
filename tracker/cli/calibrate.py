"""`tracker calibrate`: make calibrations, and correct or check them with recordings of a known object."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

import tracker
from tracker.calibration import files
from tracker.calibration.by_object.check import DEPTH, FOCAL, LIMIT, CalibrationCheck
from tracker.calibration.by_object.check import check as look
from tracker.calibration.by_object.looks import OFTEN
from tracker.calibration.by_object.refine import Refined, refine_cameras
from tracker.calibration.by_object.sightings import Footage
from tracker.calibration.by_object.table import find_table
from tracker.calibration.files import Calibrated, focal_deviations, halved_by_rows
from tracker.calibration.rig import save_rig
from tracker.cli import options
from tracker.cli.board import board, extrinsics, intrinsics
from tracker.cli.options import command, file_option, flag, option, several
from tracker.cli.outputs import DRAWN, OutFolder, Recording, is_recording
from tracker.cli.stills import read_images
from tracker.cli.terminal import bar, listing, say, table
from tracker.errors import CalibrationError, ImageError, TrackerError
from tracker.inputs import NO_IMAGE
from tracker.logs.opening import calibration_files
from tracker.objects.model import to_toml
from tracker.summaries.remarks import OUT_OF_VIEW, in_view
from tracker.viz.calibration import check_picture

Opened = tuple[
    tracker.CuboidModel, list[Footage], tracker.CameraRig, tracker.ColorModel, Callable[[int], None]
]

MANY = 20
"""Number of looks below which a calibration that fits may not."""


@click.group(no_args_is_help=False, commands=(board, intrinsics, extrinsics))
def calibrate() -> None:
    """Make a calibration from photos of a board, or correct one with a known object.

    Corrections change no file: they are written to a new folder. Give it as --calibration from then on.
    """


@dataclass(frozen=True, kw_only=True)
class Filmed:
    """Inputs that show a known object: recordings, and images in groups of one moment each."""

    inputs: tuple[str, ...] = several("RECORDING|IMAGE", Recording(str))
    subject: options.Subject
    cameras: options.Cameras
    stills: bool = flag("The folders hold single images, not a recording.")
    recover: bool = options.recover
    quiet: bool = flag("Print errors only.")

    @contextmanager
    def opened(self) -> Iterator[Opened]:
        """Open all inputs for the `with` block; TrackerError if one is invalid."""
        model, colors = self.subject.load()
        pictures = [path for path in self.inputs if path == NO_IMAGE or not is_recording(path)]
        rig = self.cameras.load() if self.cameras.calibration else None
        footage: list[Footage] = []
        frames = 0
        with ExitStack() as stack:
            for path in (path for path in self.inputs if path not in pictures):
                log = stack.enter_context(tracker.open_log(path, recover=self.recover))
                its = self.cameras.rig_of(Path(path), log)
                if rig is not None and footage and not its.agrees_with(rig):
                    raise CalibrationError(
                        f"{path}: found another calibration or arena than that of the recordings before it, "
                        "expected the same, or --calibration"
                    )
                rig = its
                footage.append(Footage(log, stills=self.stills))
                frames += len(log)
            if rig is None:
                raise CalibrationError("images: found no calibration, expected --calibration")
            if pictures:
                resize = self.cameras.resize_calibration and not footage
                rig, sets = _sets(pictures, rig, resize=resize)
                footage.append(Footage(sets))
                frames += len(sets)
            if not (self.quiet or in_view(rig)):
                say(f"warning: {OUT_OF_VIEW}")
            progress = stack.enter_context(bar("frames", frames, self.quiet))
            yield model, footage, rig, colors, progress

    def files(self, rig: tracker.CameraRig) -> dict[Path, Calibrated]:
        """Return the files that the cameras of an opened rig were read from, and what they hold."""
        paths = [Path(path) for path in self.cameras.calibration]
        if len(paths) == 1 and paths[0].is_dir():
            paths = files.calibration_files(paths[0], self.cameras.pattern)
        for recording in () if paths else self.inputs:
            with suppress(OSError):  # opening it reports what cannot be read
                paths += calibration_files(Path(recording))
        found, cameras = {}, {camera.name: camera for camera in rig}
        for path in paths:
            with suppress(TrackerError):
                one = files.read_calibrated(path)
                # Files of other cameras, or of other parts of the images, may lie beside them.
                camera = cameras.get(one.camera.name)
                if camera is None or (one.camera.camera_from_world != camera.camera_from_world).any():
                    continue
                its = one.resized(camera.width, camera.height).camera
                if np.allclose(its.matrix, camera.matrix, atol=0.5):
                    found[path] = one
                    del cameras[one.camera.name]
        return found

    def lenses(self, rig: tracker.CameraRig) -> dict[str, Calibrated]:
        """Return what the files of an opened rig state of the lenses, by camera name."""
        found = {one.camera.name: one for one in self.files(rig).values()}
        return {one.name: found[one.name].resized(one.width, one.height) for one in rig if one.name in found}


_output = option("DIR", "Folder for the new calibration; new or empty.", OutFolder(new=True), required=True)


def _sets(
    pictures: Sequence[str], rig: tracker.CameraRig, *, resize: bool
) -> tuple[tracker.CameraRig, list[Any]]:
    """Return the rig for the images' size, and sets of images of one moment each."""
    count = len(rig)
    if len(pictures) % count:
        raise ImageError(
            f"images: found {len(pictures)}, expected a multiple of {count}: one for each of "
            f"{', '.join(rig.names)} ('{NO_IMAGE}' for a missing image), moment by moment"
        )
    sets, unsized = [], set(rig.names) if resize else set()
    for first in range(0, len(pictures), count):
        rig, images = read_images(pictures[first : first + count], rig, resize=unsized)
        unsized -= {name for name, image in zip(rig.names, images, strict=True) if image is not None}
        sets.append(images)
    return rig, sets


@command(calibrate)
def check(
    filmed: Filmed,
    plot: Path | None = file_option("Draw what each camera misses (.png, .jpg).", *DRAWN),
    as_json: bool = options.as_json,
) -> None:
    """Check whether a calibration fits, with a still object.

    Give RECORDINGs, or single IMAGEs moment by moment: twenty frames or more, with the object in many places.
    Compares each camera with the others, names any camera that has moved, and states how far. Errors that all
    cameras share are not detected: a calibration whose whole world is shifted still fits.

    Also prints the errors that the files' deviations predict, and the possible depth error of each camera.
    The exit code is 1 if the calibration does not fit.
    """
    with filmed.opened() as (model, footage, rig, colors, progress):
        files = filmed.files(rig)
        found = look(model, footage, rig, colors, progress, focal_deviations(files.values()))
    fault = "its principal point was halved to c/2, expected c/2 - 0.25 px"
    remedy = "--correct-halved-principal-point mends it while it is read"
    halved = filter(halved_by_rows, () if filmed.cameras.correct_halved_principal_point else files)
    warnings = [*found.warnings, *(f"{path}: {fault}: {remedy}" for path in halved)]
    if plot is not None:
        tracker.viz.write_image(plot, check_picture(found, rig))
    if as_json:
        click.echo(json.dumps(_plain(found, warnings), allow_nan=False))
    elif not filmed.quiet:
        click.echo(_checked(found, warnings))
    if not found.fits:
        raise click.exceptions.Exit(1)


def _plain(found: CalibrationCheck, warnings: Sequence[str]) -> dict[str, Any]:
    """Return the result as plain numbers; None for unknown ones."""
    numbers = [vars(one) | {"correction": one.correction.tolist()} for one in found.cameras]
    cameras = [{name: None if value != value else value for name, value in one.items()} for one in numbers]
    return {
        "fits": found.fits,
        "looks": found.looks,
        "miss_mrad": 1e3 * found.miss,
        "warnings": list(warnings),
        "corners_focal_length_px": FOCAL,
        "depth_needed_mm": 1e3 * DEPTH,
        "cameras": cameras,
    }


def _checked(found: CalibrationCheck, warnings: Sequence[str]) -> str:
    def number(value: float, digits: int) -> str:
        return "" if math.isnan(value) else f"{value:.{digits}f}"

    rows = [["camera", "looks", "unusable", "miss [px]", "moved [mm]", "turned [°]"]]
    for one in found.cameras:
        moved = [f"{one.shift_mm:.1f}", f"{one.turn_deg:.2f}"] if one.moved else []
        rows.append([one.name, str(one.looks), str(one.cannot_use), number(one.miss_px, 2), *moved])
    expected = [["camera", "corners [px]", "stated", "shift", "shape", "fy/fx", "f ± [%]", "depth ± [mm]"]]
    for one in found.cameras:
        corners = one.corners_seen_px, one.corners_stated_px, one.corners_shift_px, one.corners_shape_px
        off = [number(one.focal_off_percent, 2), number(one.depth_off_mm, 1)]
        expected.append([one.name, *(number(px, 2) for px in corners), f"{one.focal_ratio:.4f}", *off])
    asked = [one.focal_needed_percent for one in found.cameras if not math.isnan(one.distance_m)]
    needed = number(min(asked, default=math.nan), 2)
    depth = f"error of one camera's depth; {1e3 * DEPTH:g} mm need its focal length right to {needed} %"
    below = [
        ["corners", f"how far a camera misses the object's corners [px at a focal length of {FOCAL:g} px]"],
        ["stated", "the same as the files' deviations predict"],
        ["depth", depth],
        *(["warning", one] for one in warnings),
        ["looks", str(found.looks)],
        ["verdict", _verdict(found)],
    ]
    return "\n".join([table(rows), "", table(expected), "", listing(below)])


def _verdict(found: CalibrationCheck) -> str:
    disagree = f"cameras disagree by {1e3 * found.miss:.1f} mrad (median; limit {1e3 * LIMIT:.1f})"
    if found.fits:
        few = f"; few looks: {found.looks}" if found.looks < MANY else ""
        blind = ", ".join(one.name for one in found.cameras if not one.looks)
        return f"the calibration fits: {disagree}{few}{f'; not checked: {blind}' if blind else ''}"
    moved = [one.name for one in found.cameras if one.moved]
    lost = [one.name for one in found.cameras if found.is_lost(one) and not one.moved]
    if len(moved) == 2 == sum(one.looks >= OFTEN for one in found.cameras):
        why = f"{' or '.join(moved)} has moved; only a third camera could tell which"
    elif len(moved) > 1:
        why = f"{', '.join(moved)} are elsewhere; does it belong to other cameras?"
    elif moved:
        why = f"{moved[0]} has moved"
    elif lost:
        why = f"{', '.join(lost)} should see the object but cannot use their views"
    else:
        why = f"{disagree}; does it belong to other cameras?"
    return f"the calibration does not fit: {why}"


@command(calibrate)
def refine(
    filmed: Filmed,
    output: Path = _output,
    focal: bool = flag("Fit focal lengths and principal points, too."),
    frames: int = options.whole(
        "Frames to use, in different poses; a third only checks.", default=90, least=18, most=1000
    ),
) -> None:
    """Find the cameras' relative positions, with a moving object.

    Fits the object's edges in RECORDINGs, or in many IMAGEs. Move the object all over the arena and turn it.
    A third of the frames is held out: if these fit no better, nothing is written, and the exit code is 1.

    Edges do not show where the world is. The cameras' mean x, y and yaw are kept, weighted by what the files
    state of their accuracy. So are their mean z and tilt, unless the object rests in at least five places
    (see `table`).

    Also writes object.toml with the object's rim: how far inside the nominal edges its colours end. Give this
    file as --object from then on.
    """
    with filmed.opened() as (model, footage, rig, colors, progress):
        found = refine_cameras(model, footage, rig, colors, focal=focal, most=frames, progress=progress)
    model = replace(model, colors=filmed.subject.colors or model.colors)
    lenses = filmed.lenses(rig)
    if focal:
        for one, std in zip(found.rig, found.lens_std, strict=True):
            lenses[one.name] = replace(lenses.get(one.name, Calibrated(one)), matrix_std=std)
    save_rig(found.rig, output, lenses, {"object.toml": object_text(model, found.rim)})
    if not filmed.quiet:
        click.echo(_refined(found, focal, output))


def object_text(model: tracker.CuboidModel, rim: tuple[float, float]) -> str:
    """Return the text of an object's file with a new rim and its standard deviation [m]."""
    colors = str(Path(model.colors).resolve()) if Path(model.colors).is_file() else model.colors
    return to_toml(replace(model, colors=colors, rim=max(rim[0], 0.0), rim_std=rim[1]))


def _refined(found: Refined, focal: bool, output: Path) -> str:
    rows = [["against the mean", "moved [mm]", "±", "turned [°]", "±", *(["focal", "center [px]"] * focal)]]
    for camera, moved, std, lens in zip(found.rig, found.moved, found.std, found.lenses, strict=True):
        shift, turn = 1e3 * np.linalg.norm(moved[:3]), np.degrees(np.linalg.norm(moved[3:]))
        spread = 1e3 * np.sqrt(np.square(std[:3]).mean()), np.degrees(np.sqrt(np.square(std[3:]).mean()))
        row = [camera.name, f"{shift:.2f}", f"{spread[0]:.2f}", f"{turn:.3f}", f"{spread[1]:.3f}"]
        if focal:
            row += [f"{np.expm1(lens[0]):+.2%}", f"{lens[1]:+.2f}, {lens[2]:+.2f}"]
        rows.append(row)
    unknown = "x, y and yaw of the world"
    if found.plane is None:
        unknown += ", z and tilt (the object rested too rarely; see `tracker calibrate table`)"
    if not focal:
        unknown += "; lenses (see --focal)"
    summary = [
        ["before", f"{found.before:.3f} px: offset of edges in held-out frames"],
        ["after", f"{found.after:.3f} px"],
        ["rim", f"{1e3 * found.rim[0]:.2f} ± {1e3 * found.rim[1]:.2f} mm at the object's edges"],
        ["frames", str(found.frames)],
        ["unchanged", unknown],
        ["calibration", str(output)],
        ["object", f"{output / 'object.toml'}; it has this rim"],
    ]
    return f"{table(rows)}\n\n{listing(summary)}"


@command(calibrate, name="table")
def table_command(filmed: Filmed, output: Path = _output) -> None:
    """Find the table, with an object that rests on it.

    From RECORDINGs, or single IMAGEs moment by moment. Writes the calibration in a world whose z = 0 is the
    table (x, y and yaw stay), and an arena.toml that states how well the table is known.

    The object must rest in at least five places, spread over the table, on any face, seen by at least two
    cameras. You may hold, lift and carry it in between.
    """
    with filmed.opened() as given:
        rig, plane, shots = find_table(*given)
    save_rig(rig, output, filmed.lenses(given[2]))
    if filmed.quiet:
        return
    used, still, (height, tilt) = np.count_nonzero(plane.used), len(plane.used), plane.std
    slopes = np.degrees(np.arctan(plane.slope))
    rows = [
        ["at rest", f"in {used} of {still} places where it was still; seen in {shots} frames"],
        [
            "height [mm]",
            f"{1e3 * plane.height:+.2f} ± {1e3 * height:.2f}: the table in the given calibration",
        ],
        ["tilt [°]", f"{slopes[0]:+.2f} along x, {slopes[1]:+.2f} along y, ± {np.degrees(tilt):.2f}"],
        ["scatter [mm]", f"{1e3 * plane.scatter:.2f}: heights of resting objects"],
        ["calibration", str(output)],
    ]
    click.echo(listing(rows))
