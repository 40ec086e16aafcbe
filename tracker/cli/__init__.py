"""The command line: parse, call, print.

Errors are one line on stderr that starts with `tracker: `; EXIT_CODES describes the exit codes.
A command's module is imported when the command is used, so that `tracker --help` is quick.
"""

import io
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

import click
from click.shell_completion import CompletionItem, shell_complete

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


_COMMANDS = {
    "demo": ("demo", "Find a cube in a recording that comes with the package."),
    "detect": ("stills", "Find an object in one IMAGE per camera."),
    "track": ("track", "Find an object's pose in every frame of a recording."),
    "view": ("export", "Show a recording in time and space."),
    "live": ("live", "Track an object while cameras run."),
    "batch": ("batch", "Find an object's pose in thousands of recordings."),
    "info": ("info", "Show what is in a recording or in a file of poses."),
    "export": ("export", "Write poses as CSV, Parquet, TUM, BOP, film or plot."),
    "convert": ("export", "Write a recording and its calibration in another format."),
    "dice": ("stills", "Find the dice in one IMAGE per camera, and the error."),
    "score": ("score", "Compute the rewards of a job's folder for its task."),
    "calibrate": ("calibrate", "Calibrate cameras; check and mend calibrations."),
    "colors": ("colors", "Fit, learn and check the colours of objects."),
    "doctor": ("doctor", "Find problems of this machine, and their remedies."),
}
"""Module and short help of each command, in the order in which users need them."""


class _Commands(click.Group):
    """The commands of _COMMANDS, listed and completed without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        found: click.Command = getattr(import_module(f"tracker.cli.{_COMMANDS[cmd_name][0]}"), cmd_name)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        fitting = (name for name in _COMMANDS if name.startswith(incomplete))
        found = [CompletionItem(name, help=_COMMANDS[name][1]) for name in fitting]
        return found + click.Command.shell_complete(self, ctx, incomplete)


@click.group(
    cls=_Commands,
    no_args_is_help=False,  # click would report an error of several lines
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
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
