"""The command line of the generator: parse, call, print.

Errors are one line on stderr that starts with `synthetic: `, and exit code 2; an interrupt exits with 130,
SIGTERM with 143, SIGHUP with 129.
"""

import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import click

from tracker.errors import TrackerError, install, reason
from tracker.processes import ended_by_signals, exit_code

OBJECTS = ("cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2", "dice")
QUALITY_NAMES = ("fast", "default", "best")


@click.group(
    no_args_is_help=False,  # it would be an error of several lines
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
)
def commands() -> None:
    """Render images of the simulated TriFinger platform, with exact truth.

    Errors go to stderr in one line, with exit code 2.
    """


@commands.command()
@click.option("--object", "object_name", type=click.Choice(OBJECTS), required=True, help="The object.")
@click.option("--frames", "count", type=click.IntRange(1), required=True, help="Number of frames.")
@click.option("--seed", type=click.IntRange(0), required=True, help="Seed of everything random.")
@click.option(
    "--out", "folder", type=click.Path(path_type=Path), required=True, help="Folder, new or continued."
)
@click.option("--workers", type=click.IntRange(1, 256), default=1, help="Processes; pixels stay the same.")
@click.option("--quality", type=click.Choice(QUALITY_NAMES), default="default", help="Work per image.")
@click.option("--sequence", is_flag=True, help="Motion: frames follow each other; else single scenes.")
@click.option("--rate", type=click.FloatRange(0.1, 1000), default=10.0, help="Frames of a sequence [Hz].")
@click.option(
    "--bop",
    is_flag=True,
    help="Add the BOP layout (undistorted, millimetres, true cameras) in the folder bop.",
)
@click.option("--raw", is_flag=True, help="Images are the cameras' RGGB mosaics; of size 540.")
@click.option("--size", type=click.Choice(["270", "540"]), default="270", help="Height of the images [px].")
@click.option(
    "--calibration",
    default="simulation",
    metavar="simulation|perturbed|random|r1|r3…r8|FOLDER",
    help="The simulation's cameras, another platform's or a random rig drawn from the seed, a robot's of the "
    "recorded data, or the files of a folder.",
)
@click.option(
    "--shadows/--no-shadows", default=None, show_default=False, help="Default: as the quality says."
)
@click.option(
    "--effects",
    default="none",
    metavar="none|world|NAMES",
    help="Effects of the real world: all, or names with commas, see synthetic.effects.",
)
@click.option(
    "--look-alike",
    default=None,
    metavar="KIND",
    help="Something else in the object's place, see synthetic.world.look_alikes.KINDS; no true pose.",
)
def dataset(
    object_name: str,
    count: int,
    folder: Path,
    workers: int,
    bop: bool,
    size: str,
    calibration: str,
    effects: str,
    **more: Any,
) -> None:
    """Write images, labels, calibration and truth of FRAMES frames to a folder.

    The same command continues an interrupted run. Labels: 0 other, 1 red, 2 green, 3 blue, 4 cyan, 5 magenta,
    6 yellow; of dice their number, 1 to 25, and the truth's "object" is the list of all dice.

    With the effect `calibration`, each frame's folder holds the calibration that a tracker is given, and the
    truth holds in its world; the true cameras stand in the truth. With `timing`, the truth has stamp and pose
    of each camera.
    """
    from synthetic.effects import chosen_effects
    from synthetic.export.dataset import DatasetOptions, make_dataset
    from synthetic.frames import FrameOptions

    frames = FrameOptions(object_name, size=int(size), effects=chosen_effects(effects), **more)
    options = DatasetOptions(frames, count, calibration, bop)
    with click.progressbar(length=count, label=object_name, file=sys.stderr, show_pos=True) as bar:

        def progress(done: int, _: int) -> None:
            bar.update(done - bar.pos)

        made = make_dataset(options, folder, workers=workers, progress=progress)
    click.echo(f"{folder}: {made} frames made, {count - made} kept")


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line with `arguments` (by default those of the process), and exit."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    sys.exit(_run(sys.argv[1:] if arguments is None else list(arguments)))


def _run(arguments: list[str]) -> int:
    """Return the exit code of one run."""
    try:
        with ended_by_signals(), commands.make_context("python -m synthetic", arguments) as context:
            commands.invoke(context)
        return 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        return _fail("interrupted; the same command continues", code=exit_code(stop))
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "python -m synthetic"
        return _fail(f"{error.format_message()} (see {where} --help)")
    except click.ClickException as error:
        return _fail(error.format_message())
    except ImportError as error:
        return _fail(f"{error}: {install('synthetic')}")
    except (TrackerError, OSError) as error:
        return _fail(reason(error))
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(last.filename)}:{last.lineno}"
        return _fail(f"internal error, please report it: {type(error).__name__} in {where}: {error}")


def _fail(message: str, code: int = 2) -> int:
    click.echo(f"synthetic: {' '.join(message.split())}", err=True)
    return code
