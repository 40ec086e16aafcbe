"""Try `tracker batch` the hard way: what two workers gain over one, and killing workers and whole runs.

    python scripts/try_batch.py scale RECORDING --copies 60
    python scripts/try_batch.py kill RECORDING --copies 12 --times 5 --seed 1

Both take copies of one recording with its calibration. `kill` sends SIGKILL at random moments, to a worker
or to a run with all its workers, gives the same command again, and compares every result with those of a
run that nothing disturbed: to the bit, none missing, none done twice.
"""

from __future__ import annotations

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
    """The recording so many times, each in a folder of its own."""
    for number in range(count):
        shutil.copytree(recording, folder / f"{number:04d}")
    return folder


def begin(inputs: Path, output: Path, name: str, workers: int) -> subprocess.Popen[bytes]:
    """A run in a group of processes of its own."""
    command = ["-m", "tracker", "batch", "run", f"{inputs}/*", "--object", name, "-o", str(output), "--quiet"]
    return subprocess.Popen(
        [sys.executable, *command, "--jobs", str(workers)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def whole(inputs: Path, output: Path, name: str, workers: int) -> float:
    """Seconds that a run takes from its beginning to its end."""
    began = time.perf_counter()
    code = begin(inputs, output, name, workers).wait()
    if code:
        raise SystemExit(f"a run ended with exit code {code}")
    return time.perf_counter() - began


def contents(output: Path) -> dict[str, bytes]:
    """All results, but what names the folder they are in."""
    return {
        str(path.relative_to(output)): path.read_bytes() for kind in RESULTS for path in output.rglob(kind)
    }


def finished(output: Path) -> dict[Path, int]:
    """When each result that is whole was made."""
    return {path: path.stat().st_mtime_ns for path in output.rglob("*.summary.json")}


def workers_of(pid: int) -> list[int]:
    """Processes that a run has begun and that track."""
    listed = subprocess.run(["ps", "-wweo", "pid,ppid,args"], capture_output=True, text=True, check=True)
    rows = [line.split(None, 2) for line in listed.stdout.splitlines()[1:]]
    return [int(one) for one, parent, what in rows if int(parent) == pid and "spawn_main" in what]


def kill(inputs: Path, root: Path, name: str, times: int, rng: random.Random) -> bool:
    """Disturb runs; whether all results are as if nothing had happened."""
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
    """Compare one worker with two, in turn, so that what else the machine does meets both.

    Where two need more processor time than one, the machine's cores are not two whole ones.
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
    """Of all runs that have ended, with their workers [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Try what the arguments say."""
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
    warm_up()  # else the first run would compile, and the moments be those of a run that does
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        inputs = copies_of(given.recording, given.copies, root / "in")
        if given.what == "scale":
            scale(inputs, root / "out", given.object)
            return 0
        return 0 if kill(inputs, root / "out", given.object, given.times, random.Random(given.seed)) else 1


if __name__ == "__main__":
    sys.exit(main())
