"""Stress-test `tracker batch`: the gain of two workers over one, and killed workers and runs.

    python scripts/try_batch.py scale RECORDING --copies 60
    python scripts/try_batch.py kill RECORDING --copies 12 --times 5 --seed 1

Both use copies of one recording with its calibration. `kill` sends SIGKILL at random times, to a worker or to
a run with all its workers, repeats the command, and compares every result with those of an undisturbed run:
they must be equal to the bit, with none missing and none done twice.
"""

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tracker.warm_up import warm_up

RESULTS = ("*.poses.h5", "*.summary.json", "summary.parquet", "failures.json")


def copies_of(recording: Path, count: int, folder: Path) -> Path:
    """Copy the recording `count` times, each into its own folder."""
    for number in range(count):
        shutil.copytree(recording, folder / f"{number:04d}")
    return folder


def begin(inputs: Path, output: Path, name: str, workers: int) -> subprocess.Popen[bytes]:
    """Start a run in its own process group."""
    command = ["-m", "tracker", "batch", "run", f"{inputs}/*", "--object", name, "-o", str(output), "--quiet"]
    return subprocess.Popen(
        [sys.executable, *command, "--jobs", str(workers)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def whole(inputs: Path, output: Path, name: str, workers: int) -> float:
    """Return the duration of a complete run [s]."""
    began = time.perf_counter()
    code = begin(inputs, output, name, workers).wait()
    if code:
        raise SystemExit(f"a run ended with exit code {code}")
    return time.perf_counter() - began


def contents(output: Path) -> dict[str, bytes]:
    """Return all results that do not contain the folder's name."""
    return {
        str(path.relative_to(output)): path.read_bytes() for kind in RESULTS for path in output.rglob(kind)
    }


def finished(output: Path) -> dict[Path, int]:
    """Return the time at which each complete result was made."""
    return {path: path.stat().st_mtime_ns for path in output.rglob("*.summary.json")}


def workers_of(pid: int) -> list[int]:
    """Return the ids of a run's worker processes."""
    listed = subprocess.run(["ps", "-wweo", "pid,ppid,args"], capture_output=True, text=True, check=True)
    rows = [line.split(None, 2) for line in listed.stdout.splitlines()[1:]]
    return [int(one) for one, parent, what in rows if int(parent) == pid and "spawn_main" in what]


def kill(inputs: Path, root: Path, name: str, times: int, rng: random.Random) -> bool:
    """Disturb runs; return whether all results equal those of an undisturbed run."""
    seconds = whole(inputs, root / "undisturbed", name, 2)
    expected, well = contents(root / "undisturbed"), True
    for number in range(times):
        for victim in ("worker", "run"):
            output = root / f"{victim}{number}"
            moment = rng.uniform(0.1, 0.95) * seconds
            run = begin(inputs, output, name, 2)
            time.sleep(moment)
            before = finished(output)
            if victim == "worker":
                hit = workers_of(run.pid)
                if hit:
                    os.kill(rng.choice(hit), signal.SIGKILL)
                code = run.wait()
            else:
                os.killpg(run.pid, signal.SIGKILL)
                run.wait()
                whole(inputs, output, name, 2)
                hit, code = [run.pid], 0
            again = sum(before[path] != now for path, now in finished(output).items() if path in before)
            same = contents(output) == expected
            well &= same and not again and not code
            there = "hit" if hit else "there was none"
            print(
                f"{victim} killed after {moment:5.1f} s ({there}), {len(before)} done before: "
                f"{'the same bits' if same else 'OTHER RESULTS'}, {again} done twice, exit code {code}",
                flush=True,
            )
            shutil.rmtree(output)
    return well


def scale(inputs: Path, root: Path, name: str) -> None:
    """Compare one worker with two, alternating, so that other load affects both.

    If two need more processor time than one, the machine does not have two whole cores.
    """
    for turn in range(2):
        times, spent = [], []
        for workers in (1, 2):
            before = _processor_time()
            times.append(whole(inputs, root / f"{turn}{workers}", name, workers))
            spent.append(_processor_time() - before)
        print(
            f"one worker {times[0]:.1f} s ({spent[0]:.1f} s of processor time), two {times[1]:.1f} s "
            f"({spent[1]:.1f} s): × {times[0] / times[1]:.2f} (load {os.getloadavg()[0]:.1f})",
            flush=True,
        )


def _processor_time() -> float:
    """Return the processor time of all ended runs with their workers [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Run the chosen test."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["scale", "kill"])
    parser.add_argument("recording", type=Path, help="a folder")
    parser.add_argument("--object", default="cube_v2")
    parser.add_argument("--copies", type=int, default=12)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    warm_up()  # otherwise the first run would compile, and kill times would be scaled by its duration
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        inputs = copies_of(given.recording, given.copies, root / "in")
        if given.what == "scale":
            scale(inputs, root / "out", given.object)
            return 0
        return 0 if kill(inputs, root / "out", given.object, given.times, random.Random(given.seed)) else 1


if __name__ == "__main__":
    sys.exit(main())
