"""`python -m benchmarks`; if packages are missing, prints how to install them."""

import sys

import click

from tracker.errors import TrackerError, reason
from tracker.processes import ended_by_signals, exit_code


def _run() -> int:
    """Return the exit code of one run."""
    code = 2
    try:
        with ended_by_signals():
            from benchmarks.program import main

            with main.make_context("python -m benchmarks", sys.argv[1:]) as context:
                main.invoke(context)
        return 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        message, code = "interrupted", exit_code(stop)
    except ImportError as error:
        message = f"{error}: python3 -m pip install -e '.[bench,synthetic]'"
    except (TrackerError, OSError) as error:
        message = reason(error)
    print(f"benchmarks: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(_run())
