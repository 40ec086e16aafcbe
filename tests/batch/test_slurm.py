import contextlib
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.helpers import ROOT, contents
from tests.helpers.slurm import Slurm, single_node, until
from tracker.batch.jobs import RECORDINGS_A_JOB
from tracker.batch.results import summary_file
from tracker.batch.run import Batch, run_batch
from tracker.batch.workers import engine
from tracker.recordings import Options

pytestmark = pytest.mark.slow

COUNT, FRAMES = RECORDINGS_A_JOB + 2, 3
"""Two jobs, of which one has most of the recordings."""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory) -> Iterator[Slurm]:
    with single_node(tmp_path_factory.mktemp("slurm")) as found:
        yield found


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Path:
    """Some of the recording that comes with the package, again and again; with names that shells dislike."""
    root = tmp_path_factory.mktemp("it's in")
    demo = ROOT / "tracker" / "demo"
    for number in range(COUNT):
        folder = root / f"{number:03d}"
        folder.mkdir()
        for path in demo.glob("camera*.yml"):
            shutil.copy(path, folder)
        for path in sorted(demo.glob("0*"))[number % 3 : number % 3 + FRAMES]:
            shutil.copytree(path, folder / path.name)
    return root


@pytest.fixture(scope="module")
def here(recordings, tmp_path_factory) -> dict[str, bytes]:
    """What this process makes of them."""
    one = Batch.of([f"{recordings}/*"], tmp_path_factory.mktemp("here"), Options("cube_v2"))
    assert run_batch(one.work(), engine(1), lambda _: None) == 0
    return made(one.folder)


@pytest.fixture
def results(tmp_path) -> Path:
    """A folder for results with a name that shells dislike."""
    return tmp_path / 'it\'s %a "folder" $(pwd)\n#SBATCH --array=9'


@pytest.fixture
def submit(slurm, recordings, results, run_here, monkeypatch) -> Callable[[], str]:
    """Gives the command, always the same, to Slurm; what it prints."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def submit_it() -> str:
        result = run_here("batch", "run", f"{recordings}/*", "--object", "cube_v2", "-o", results, "--slurm")
        assert result.returncode == 0, result.stderr
        return result.stdout

    return submit_it


def made(folder: Path) -> dict[str, bytes]:
    """Poses and the lines about them."""
    suffixes = (".poses.h5", ".summary.json", ".failed.json")
    return {name: content for name, content in contents(folder).items() if name.endswith(suffixes)}


def done(folder: Path) -> dict[Path, tuple[int, int]]:
    """Files of poses that are whole; another one has another identity."""
    whole = [path for path in folder.rglob("*.poses.h5") if summary_file(path).exists()]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in whole}


def worker_of(results: Path) -> int:
    """The process that does the first job's recordings."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # of a process that has ended
            *command, number = os.fsdecode(path.read_bytes()).rstrip("\0").split("\0")
            if command[1:5] == ["-m", "tracker", "batch", "share"] and number == "0":
                found += [int(path.parent.name)] * command[5].startswith(str(results))
    (worker,) = found
    return worker


def numbers(run_here, results: Path) -> dict[str, int]:
    return json.loads(run_here("batch", "status", results, "--json").stdout)


def test_a_job_whose_process_is_killed_is_begun_again_and_a_second_run_does_nothing(
    slurm, submit, results, here, run_here
):
    printed = submit()
    assert f"{COUNT} recordings" in printed
    job = printed.split("Submitted batch job ")[1].split()[0]
    until(lambda: done(results), slurm.folder)
    os.kill(worker_of(results), signal.SIGKILL)
    before = done(results)
    assert numbers(run_here, results)["missing"] > 0
    slurm.finish()
    assert "Restarts=1" in slurm.ask("scontrol", "--oneliner", "show", "job", f"{job}_0")
    assert "Restarts=0" in slurm.ask("scontrol", "--oneliner", "show", "job", f"{job}_1")
    assert made(results) == here
    assert before.items() <= done(results).items()
    counts = numbers(run_here, results)
    assert (counts["done"], counts["failed"], counts["missing"], counts["running"]) == (COUNT, 0, 0, 0)
    whole = done(results)
    assert submit() == f"all {COUNT} recordings are done\n"
    assert not slurm.jobs()
    assert done(results) == whole


def test_what_jobs_that_are_cancelled_have_left_is_done_by_the_same_command(
    slurm, submit, results, here, run_here
):
    job = submit().split("Submitted batch job ")[1].split()[0]
    until(lambda: done(results), slurm.folder)
    slurm.ask("scancel", job)
    slurm.finish()
    before = done(results)
    counts = numbers(run_here, results)
    assert (counts["done"], counts["failed"], counts["running"]) == (len(before), 0, 0)
    assert counts["missing"] == COUNT - len(before) > 0
    assert f"\n{COUNT - len(before)} recordings" in submit()
    slurm.finish()
    assert made(results) == here
    assert before.items() <= done(results).items()
    assert numbers(run_here, results)["running"] == 0
