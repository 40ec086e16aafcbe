"""Build the sdist and a wheel from it, and try the wheel in clean environments.

    python scripts/try_release.py [--output FOLDER] [PYTHON ...]

Checks the wheel's contents and installs it for each Python into a separate environment, without extras. With
the first Python it runs what a user would; commands that need an extra must name it, and a strict type
checker reads the examples. With the others it finds a pose, which compiles everything.
"""

import argparse
import os
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
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

BATCH = ["batch", "run", "tracker-demo", "--object", "cube_v2", "-o"]

RUNS = (
    ["demo"],
    ["detect", *ONE_SET, *IMAGES, "--overlay", "mine.png"],
    ["track", "tracker-demo", "--object", "cube_v2", "-o", "poses.h5", "--csv", "poses.csv"],
    ["dice", "--calibration", DICE, "--goal", DICE / "goal.json"]
    + [DICE / f"camera{angle}.png" for angle in (60, 180, 300)],
    ["info", "poses.h5"],
    [*BATCH, "results"],
    ["doctor"],
)
"""Commands that must work without any extra."""

SMOKE = RUNS[:2]
"""Commands that are tried with each Python."""

MISSED = {
    "plot": ["track", "tracker-demo", "--object", "cube_v2", "-o", "b.h5", "--plot", "b.png"],
    "video": ["track", "tracker-demo", "--object", "cube_v2", "-o", "b.h5", "--video", "b.mp4"],
    "rerun": ["view", "poses.h5", "-o", "view.rrd"],
    "cluster": [*BATCH, "more", "--scheduler", "tcp://127.0.0.1:8786"],
    "live": ["live", "tracker-demo", *ONE_SET, "--publish", "tcp://127.0.0.1:5555"],
    "lcm": ["live", "tracker-demo", *ONE_SET, "--publish", "lcm://"],
    "pylon": ["live", "pylon", *ONE_SET],
    "synthetic": ["live", "simulation", "--object", "cube_v2"],
}
"""Commands that need an extra, by extra."""

TYPED = ("detect_cube.py", "track_recording.py", "task_errors.py", "own_arena.py")


def build(output: Path) -> Path:
    """Build the sdist and the wheel from it; return the wheel.

    Raises:
        SystemExit: it holds names other than the package's, or lacks some of its files.
    """
    for old in output.glob("trifinger_object_tracker-*"):
        old.unlink()
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(output), str(ROOT)]
    subprocess.run(command, check=True)
    (wheel,) = output.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    top = {name.partition("/")[0] for name in names}
    other = sorted(name for name in top if name != "tracker" and not name.endswith(".dist-info"))
    missing = [name for name in SHIPPED if f"tracker/{name}" not in names]
    if other or missing:
        raise SystemExit(f"{wheel.name}: holds {other} besides the package, and lacks {missing}")
    return wheel


def install(wheel: Path, python: str, folder: Path) -> Path:
    """Create an environment with the wheel and its requirements; return its interpreter."""
    subprocess.run([python, str(ROOT / "scripts" / "kept_environment.py"), str(folder), "."], check=True)
    own = folder / "bin" / "python"
    pip = [str(own), "-m", "pip", "--disable-pip-version-check"]
    subprocess.run([*pip, "install", "--quiet", "--no-deps", str(wheel)], check=True)
    subprocess.run([*pip, "check"], check=True, stdout=subprocess.DEVNULL)
    return own


def run(python: Path, folder: Path, works: Sequence[list[object]], missed: dict[str, list[object]]) -> None:
    """Run commands that work, and by extra commands that need one, in an empty folder.

    Raises:
        SystemExit: something fails, or fails in another way than it should.
    """

    def tried(arguments: list[object]) -> subprocess.CompletedProcess[str]:
        command = [str(python.with_name("tracker")), *map(str, arguments)]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=600)

    for arguments in works:
        result = tried(arguments)
        if result.returncode:
            raise SystemExit(f"{python}: {arguments}: {result.stdout}{result.stderr}")
    for extra, arguments in missed.items():
        result = tried(arguments)
        if result.returncode != 2 or f".[{extra}]" not in result.stderr:
            raise SystemExit(f"{python}: {arguments}: names no extra {extra}: {result.stdout}{result.stderr}")


def check_types(python: Path) -> None:
    """Check the examples with a strict type checker, as a user would, against the installed package."""
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

    def attempt(number: int, python: str) -> None:
        folder = arguments.output / f"try-{number}"
        own = install(wheel, python, folder)
        empty = folder / "empty"
        empty.mkdir()
        run(own, empty, *((SMOKE, {}) if number else (RUNS, MISSED)))
        if number == 0:
            check_types(own)
        print(f"{wheel.name}: works with {python}", flush=True)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(attempt, range(len(arguments.pythons)), arguments.pythons))


if __name__ == "__main__":
    main()
