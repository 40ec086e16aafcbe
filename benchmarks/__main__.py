"""`python -m benchmarks`; if packages are missing, prints how to install them."""

from __future__ import annotations

import sys

from tracker.errors import TrackerError


def _run() -> int:
    """Return the exit code of one run."""
    try:
        from benchmarks.program import main

        main()
        return 0
    except ImportError as error:
        reason = f"{error}: python3 -m pip install -e '.[bench,synthetic]'"
    except TrackerError as error:
        reason = str(error)
    print(f"benchmarks: {reason}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(_run())
