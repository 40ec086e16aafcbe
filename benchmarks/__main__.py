"""`python -m benchmarks`; if packages are missing, prints how to install them."""

import sys

from tracker.errors import TrackerError, reason


def _run() -> int:
    """Return the exit code of one run."""
    try:
        from benchmarks.program import main

        main()
        return 0
    except ImportError as error:
        message = f"{error}: python3 -m pip install -e '.[bench,synthetic]'"
    except (TrackerError, OSError) as error:
        message = reason(error)
    print(f"benchmarks: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(_run())
