"""Build the sdist, of it the wheel, and try the wheel where there is nothing else.

    python scripts/try_release.py [--output FOLDER] [PYTHON ...]

Looks at what the wheel holds, installs it for each Python into an environment of its own, without extras,
and runs there what a user would; what needs an extra has to name it. A strict type checker reads the
examples against the first of them.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = (
    "py.typed",
    "demo/truth.json",
    "objects/data/cube_v2.toml",
    "segmentation/data/cube_v2.npz",
    "viz/fonts/LICENSE",
)
IMAGES = [f"tracker-demo/000000/camera{angle}.jpg" for angle in (60, 180, 300)]
DICE = ROOT / "examples" / "dice"
ONE_SET = ["--object", "cube_v2", "--calibration", "tracker-demo"]

RUNS = (
    ["demo"],
    ["detect", *ONE_SET, *IMAGES, "--overlay", "mine.png"],
    ["track", "tracker-demo", "--object", "cube_v2", "-o", "poses.h5", "--csv", "poses.csv"],
    ["dice", "--calibration", DICE, "--goal", DICE / "goal.json"]
    + [DICE / f"camera{angle}.png" for angle in (60, 180, 300)],
    ["info", "poses.h5"],
    ["doctor"],
)
"""What has to work without any extra."""

MISSED = {
    "plot": ["track", "tracker-demo", "--object", "cube_v2", "-o", "b.h5", "--plot", "b.png"],
    "video": ["track", "tracker-demo", "--object", "cube_v2", "-o", "b.h5", "--video", "b.mp4"],
    "rerun": ["view", "poses.h5", "-o", "view.rrd"],
    "cluster": ["batch", "tracker-demo", "--object", "cube_v2", "-o", "results"],
    "live": ["live", "tracker-demo", *ONE_SET, "--publish", "tcp://127.0.0.1:5555"],
    "lcm": ["live", "tracker-demo", *ONE_SET, "--publish", "lcm://"],
    "pylon": ["live", "pylon", *ONE_SET],
    "synthetic": ["live", "simulation", "--object", "cube_v2"],
}
"""By extra, what needs it."""

TYPED = ("detect_cube.py", "track_recording.py", "task_errors.py", "own_arena.py")


def build(output: Path) -> Path:
    """The wheel, made of the sdist.

    Raises:
        SystemExit: it holds other names than the package's, or lacks some of its files.
    """
    for old in output.glob("trifinger_object_tracker-*"):
        old.unlink()
    subprocess.run([sys.executable, "-m", "build", "--outdir", str(output), str(ROOT)], check=True)
    (wheel,) = output.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    top = {name.partition("/")[0] for name in names}
    other = sorted(name for name in top if name != "tracker" and not name.endswith(".dist-info"))
    missing = [name for name in SHIPPED if f"tracker/{name}" not in names]
    if other or missing:
        raise SystemExit(f"{wheel.name}: holds {other} besides the package, and lacks {missing}")
    return wheel


def install(wheel: Path, python: str, folder: Path) -> Path:
    """The interpreter of a new environment that has the wheel and what it needs."""
    subprocess.run([python, "-m", "venv", "--clear", str(folder)], check=True)
    own = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([str(own), *pip, str(wheel)], check=True)
    return own


def run(python: Path, folder: Path) -> None:
    """Run what a user would, in an empty folder.

    Raises:
        SystemExit: something fails, or fails in another way than it should.
    """

    def tried(arguments: list[object]) -> subprocess.CompletedProcess[str]:
        command = [str(python.with_name("tracker")), *map(str, arguments)]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=600)

    for arguments in RUNS:
        result = tried(list(arguments))
        if result.returncode:
            raise SystemExit(f"{python}: {arguments}: {result.stdout}{result.stderr}")
    for extra, arguments in MISSED.items():
        result = tried(list(arguments))
        if result.returncode != 2 or f".[{extra}]" not in result.stderr:
            raise SystemExit(f"{python}: {arguments}: names no extra {extra}: {result.stdout}{result.stderr}")


def check_types(python: Path) -> None:
    """Read the examples as a user's strict type checker does, against what is installed."""
    examples = [str(ROOT / "examples" / name) for name in TYPED]
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--python-executable", str(python)]
    subprocess.run([*command, *examples], cwd=python.parent, check=True)


def main() -> None:
    """Build, install, run, check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("pythons", nargs="*", default=[sys.executable], metavar="PYTHON")
    parser.add_argument("--output", type=Path, default=ROOT / "build" / "release", metavar="FOLDER")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    wheel = build(arguments.output)
    for number, python in enumerate(arguments.pythons):
        folder = arguments.output / f"try-{number}"
        own = install(wheel, python, folder)
        empty = folder / "empty"
        empty.mkdir()
        run(own, empty)
        if number == 0:
            check_types(own)
        print(f"{wheel.name}: works with {python}")


if __name__ == "__main__":
    main()
