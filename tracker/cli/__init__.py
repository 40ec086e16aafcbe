"""The command line: parse, call, print.

Errors are one line on stderr that starts with `tracker: `; EXIT_CODES describes the exit codes.
Commands import what they need when they run, so that `--help` is quick.
"""

from __future__ import annotations

import io
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import NoReturn

import click
from click.shell_completion import shell_complete

from tracker.cli import batch, calibrate, colors, demo, doctor, export, info, live, score, stills, track
from tracker.cli.terminal import say
from tracker.errors import NotBetterError, TrackerError, reason
from tracker.processes import ended_by_signals, exit_code
from tracker.version import version

EXIT_CODES = {
    0: "done",
    1: "no: not found (with --exit-code), does not fit, no improvement, a check failed",
    2: "an error: usage, input, a recording that failed, an output that cannot be written, no images at all",
    129: "ended by SIGHUP: the terminal was closed",
    130: "interrupted by Ctrl-C",
    143: "ended by SIGTERM",
}
"""Meanings of the exit codes of all commands."""

_COMPLETE = "_TRACKER_COMPLETE"  # environment variable for click's shell completion


def _print_version(context: click.Context, _: click.Parameter, requested: bool) -> None:
    if not requested or context.resilient_parsing:
        return
    click.echo(f"tracker {version()}")
    context.exit()


class _InTheirOrder(click.Group):
    """Lists its commands in the order in which users need them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(
    cls=_InTheirOrder,
    no_args_is_help=False,  # click would report an error of several lines
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    commands=[
        demo.demo,
        stills.detect,
        track.track,
        export.view,
        live.live,
        batch.batch,
        info.info,
        export.export,
        export.convert,
        stills.dice,
        score.score,
        calibrate.calibrate,
        colors.colors,
        doctor.doctor,
    ],
    epilog="\b\nExit codes:\n" + "\n".join(f"  {code:<4} {what}" for code, what in EXIT_CODES.items()),
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version.",
)
def commands() -> None:
    """Find the pose of coloured objects in the images of calibrated cameras.

    Begin with `tracker demo`. Errors go to stderr in one line.
    """


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line with `arguments` (by default those of the process), and exit."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file's name may not fit the terminal's encoding
    asked = os.environ.get(_COMPLETE)
    if asked:  # a shell asks for completions
        sys.exit(shell_complete(commands, {}, "tracker", _COMPLETE, asked))
    sys.exit(_run(sys.argv[1:] if arguments is None else list(arguments)))


def _run(arguments: list[str]) -> int:
    try:
        arguments = arguments or ["--help"]
        with ended_by_signals(), commands.make_context("tracker", arguments) as context:
            commands.invoke(context)
        return 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        return _fail("interrupted", code=exit_code(stop))
    except BrokenPipeError:
        _drop_output_that_cannot_be_written()
        return 2  # no message: the reader of the output has closed it
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "tracker"
        return _fail(f"{error.format_message()} (see {where} --help)")
    except click.ClickException as error:
        return _fail(error.format_message())
    except TrackerError as error:
        return _fail(str(error), code=1 if isinstance(error, NotBetterError) else 2)
    except OSError as error:
        _drop_output_that_cannot_be_written()
        return _fail(reason(error))
    except Exception as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # raised while a compiled module was imported
            return _fail("interrupted", code=exit_code(error.__cause__))
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(last.filename)}:{last.lineno}"
        what = f"{type(error).__name__} in {where}: {error}"
        return _fail(f"internal error, please report it if `tracker doctor` finds no problem: {what}")


def _fail(message: str, code: int = 2) -> int:
    say(message)
    return code


def _drop_output_that_cannot_be_written() -> None:
    """Prevent an error message when the interpreter flushes stdout at exit."""
    try:
        if sys.stdout is not None:  # closed by the parent process
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
