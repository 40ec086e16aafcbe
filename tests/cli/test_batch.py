import errno
import json
import os
import signal
import subprocess
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from tests.helpers import contents
from tests.helpers.command import assert_one_line_error, begin, until, well, workers_of
from tests.helpers.recording_stubs import write_log
from tracker.batch.results import summary_file
from tracker.batch.run import Batch, only_run, read_batch, run_batch
from tracker.batch.tables import state, write_tables
from tracker.batch.workers import engine
from tracker.files import write_whole
from tracker.recordings import Job, Options, Tracked, run

COUNT, FRAMES = 5, 5


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("in")
    for number in range(COUNT):
        write_log(root / f"{number:03d}", FRAMES + number)
    return root


@pytest.fixture(scope="module")
def undisturbed(recordings, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What one process makes of the recordings in one go."""
    one = Batch.of([f"{recordings}/*"], tmp_path_factory.mktemp("undisturbed"), Options("cube_v2"))
    with only_run(one, one.work()):
        assert run_batch(one.work(), engine(1), lambda _: None) == 0
        write_tables(one, state(one), as_csv=False)
    return contents(one.folder)


def run_on(recordings: Path, folder: Path, *more: object) -> tuple[object, ...]:
    """Arguments of a run on all recordings."""
    return ("batch", "run", f"{recordings}/*", "--object", "cube_v2", "-o", folder, *more)


def start(recordings: Path, folder: Path) -> subprocess.Popen[bytes]:
    """A run of two workers that is at work on recordings."""
    process = begin(*run_on(recordings, folder, "--jobs", 2))
    # What a killed run has left is gone when there are workers.
    until(lambda: workers_of(process) and list(folder.rglob(".*.poses.h5.lock")), process)
    return process


@pytest.mark.slow
def test_killed_workers_and_runs_lose_nothing_and_do_nothing_twice(recordings, undisturbed, tmp_path):
    process = start(recordings, tmp_path)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=120)
    whole = [path for path in tmp_path.rglob("*.poses.h5") if summary_file(path).exists()]
    done = {path: path.stat().st_mtime_ns for path in whole}
    process = start(recordings, tmp_path)
    os.kill(workers_of(process)[0], signal.SIGKILL)
    try:
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert (process.returncode, err) == (0, b"")
    assert f"done        {COUNT}".encode() in out
    assert contents(tmp_path) == undisturbed
    assert {path: path.stat().st_mtime_ns for path in done} == done


@pytest.mark.slow
def test_workers_of_another_scheduler_give_the_same(recordings, undisturbed, tmp_path, run_here):
    distributed = pytest.importorskip("distributed", reason="cluster: no module distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        arguments = run_on(recordings, tmp_path / "results", "--scheduler", cluster.scheduler_address)
        result = run_here(*arguments)
    assert (result.returncode, result.stderr) == (0, "")
    assert contents(tmp_path / "results") == undisturbed


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_leaves_what_is_done(recordings, undisturbed, tmp_path):
    process = start(recordings, tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, b"", b"tracker: interrupted\n")
    assert not list(tmp_path.rglob(".*"))


def test_a_full_disk_is_reported_with_what_to_do(recordings, tmp_path, run_here, monkeypatch):
    def full(path: Path, *_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    def full_but_for_the_list(path: Path, content: str) -> None:
        (write_whole if path.name == "batch.json" else full)(path, content)

    def full_for_one(job: Job) -> Tracked:
        if "001" in job.log.name:
            full(job.output)
        return run(job)

    monkeypatch.setattr("tracker.cli.batch.processes", lambda _: engine(1))
    base = ["batch", "run", f"{recordings}/00[01]", "--object", "cube_v2", "-o", tmp_path, "--to", 4]
    with monkeypatch.context() as disk:
        disk.setattr("tracker.batch.run.run", full_for_one)
        disk.setattr("tracker.batch.run.write_whole", full_but_for_the_list)
        for name in ("write_whole", "write_parquet"):
            disk.setattr(f"tracker.batch.tables.{name}", full)
        nothing = run_here(*base)
        disk.setattr("tracker.batch.run.write_whole", write_whole)
        some = run_here(*base, "-q")
    assert (nothing.returncode, some.returncode) == (2, 2)
    assert "failed      2" in nothing.stdout
    assert "001.poses.h5: No space left on device" in nothing.stdout
    failed, table = some.stderr.splitlines()
    assert failed.startswith("tracker: 1 of 2 recordings failed, the first: ")
    assert "failures.json: cannot be written: No space left on device. The results of 1 of 2" in table
    assert f"`tracker batch status {tmp_path} --write`" in table
    written = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert written == {"batch.json", "000.poses.h5", "000.summary.json", "001.failed.json"}
    assert run_here(*base, "-q").returncode == 0
    assert len(state(read_batch(tmp_path)).lines) == 2


def test_status_is_reported_for_people_and_programs(recordings, tmp_path, run_here):
    pairs = [(str(path), f"{path.name}.poses.h5") for path in sorted(recordings.iterdir())]
    pairs[1] = ("/in/first\nsecond", pairs[1][1])
    one = Batch(tmp_path, Options("cube_v2"), tuple(pairs))
    with only_run(one, one.work()):
        pass
    (tmp_path / "001.failed.json").write_text('{"reason": "it is broken"}')
    shown = well(run_here("batch", "status", tmp_path))
    assert f"missing     {COUNT - 1}" in shown.stdout
    assert "  /in/first second: it is broken\n" in shown.stdout
    numbers = json.loads(run_here("batch", "status", tmp_path, "--json", "--write").stdout)
    assert (numbers["recordings"], numbers["done"], numbers["failed"], numbers["missing"]) == (COUNT, 0, 1, 4)
    assert (tmp_path / "failures.json").is_file()


def test_a_recording_may_be_called_as_a_command(tmp_path, run_here, monkeypatch):
    monkeypatch.setattr("tracker.cli.batch.processes", lambda _: engine(1))
    for name in ("status", "run"):
        write_log(tmp_path / name, 2)
    asked = ("--object", "cube_v2", "-o", "out", "--jobs", 1)
    result = run_here("batch", "run", "status", "run", *asked, folder=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert run_here("batch", "status", "out", folder=tmp_path).stdout.splitlines()[1].split() == ["done", "2"]


@pytest.mark.parametrize(("scheduler", "word"), [("--htcondor", "queue number from"), ("--slurm", "#SBATCH")])
def test_a_dry_run_prints_and_writes_nothing(scheduler, word, recordings, tmp_path, run_here):
    assert word in well(run_here(*run_on(recordings, tmp_path / "out", scheduler, "--dry-run"))).stdout
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "foo://127.0.0.1:9", "tls://h:9", ""])
def test_a_scheduler_that_does_not_answer_is_named(address, recordings, tmp_path, run_here, monkeypatch):
    monkeypatch.setattr("tracker.batch.workers.CONNECT_SECONDS", 0.5)
    if not address.startswith("tcp"):  # what is begun with it would hold up this process's end
        distributed = pytest.importorskip("distributed", reason="cluster: no module distributed")
        monkeypatch.delattr(distributed, "Client")
    result = run_here(*run_on(recordings, tmp_path / "out", "--scheduler", address))
    assert_one_line_error(result, f"scheduler {address}: does not answer")
    assert not list(tmp_path.rglob("*.poses.h5"))


def test_what_is_submitted_again_is_neither_done_nor_failed_and_has_no_row(tmp_path, run_here, monkeypatch):
    monkeypatch.setattr("tracker.cli.batch.processes", lambda _: engine(1))
    monkeypatch.setattr("tracker.batch.jobs.subprocess.run", lambda *_, **__: CompletedProcess([], 0, "7"))
    for name in ("0", "1", "2"):
        write_log(tmp_path / "in" / name, 2)
    (tmp_path / "in" / "2" / "camera_data.dat").write_bytes(b"damaged")
    base, table = run_on(tmp_path / "in", tmp_path / "out"), tmp_path / "out" / "summary.csv"
    run_here(*base, "--csv")
    os.utime(tmp_path / "in" / "1" / "camera60.yml", (0, 0))
    for option, counts in [("--dry-run", (1, 2, 0)), ("-q", (0, 1, 2))]:
        well(run_here(*base, "--slurm", option))
        numbers = json.loads(run_here("batch", "status", tmp_path / "out", "--json").stdout)
        assert (numbers["failed"], numbers["done"], numbers["missing"]) == counts
        assert len(table.read_text(encoding="utf-8").splitlines()) == 1 + counts[1]
