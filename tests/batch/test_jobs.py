import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.helpers import run_python
from tests.helpers.recording_stubs import NoiseTracker
from tracker.batch import jobs
from tracker.batch.run import Batch, read_batch
from tracker.errors import LogError, TrackerError
from tracker.recordings import Options

OPTIONS = Options("cube_v2", make_tracker=NoiseTracker)


def described(folder: Path, count: int, scheduler: str) -> jobs.Description:
    one = Batch(folder, OPTIONS, tuple((f"/in/{number}", f"{number}.poses.h5") for number in range(count)))
    return jobs.describe(one, [task for task, _ in one.work()], scheduler)


EVIL = 'it\'s %a "folder"\n#SBATCH --mem=9\n$(touch owned) `touch owned`'


def test_a_script_of_slurm_does_a_share_whatever_paths_are_called(tmp_path, monkeypatch):
    folder = tmp_path / EVIL
    folder.mkdir()
    (tmp_path / "it's").mkdir()
    python = tmp_path / "it's" / "a $(touch owned) `touch owned` python"
    python.write_text('#!/bin/sh\npwd\nprintf "%s|" "$@" "$OMP_NUM_THREADS"\nexit 2\n')
    python.chmod(0o700)
    monkeypatch.setattr(jobs.sys, "executable", str(python))
    description = described(folder, 10_500, "slurm")
    assert "--array=0-954\n" in description.text  # thousands of recordings are some jobs
    directives = [line for line in description.text.splitlines() if line.startswith("#SBATCH")]
    assert directives[-1] == "#SBATCH --output=/dev/null"
    assert "#SBATCH --mem=1500M" in directives
    description.write()
    place = description.path.parent
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "7")
    command = ["sh", description.path.name]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    # Elsewhere no file of others is taken for a module.
    (log,) = (place / "logs").iterdir()
    assert log.name == f"{description.path.stem}-7.out"
    assert log.read_text() == f"/\n-m|tracker|batch|share|{description.path.with_suffix('.json')}|7|1|"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")
    assert {path.name for path in tmp_path.rglob("*")} == {
        *(python.name, "it's", ".jobs", "logs", folder.name),
        *(description.path.name, description.path.with_suffix(".json").name, log.name),
    }


def test_a_description_of_htcondor_does_a_share_whatever_paths_are_called(tmp_path, monkeypatch):
    htcondor = pytest.importorskip("htcondor2", reason="htcondor: no module htcondor2")
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(jobs.sys, "executable", "/a $(arguments) 'b'/python")
        description = described(tmp_path / EVIL, 25, "htcondor")
    submit = htcondor.Submit(description.text)
    assert [item["number"] for item in submit.itemdata()] == ["0", "1", "2"]
    assert submit["executable"] == "/a $(DOLLAR)(arguments) 'b'/python"
    assert submit["max_materialize"] == "200"
    program, arguments = submit["arguments"].strip('"').removeprefix("-c '").split("' ")
    assert arguments == f"batch share {description.path.with_suffix('.json').name} $(number)"
    (tmp_path / "cv2.py").write_text("raise SystemExit('a file of others was imported')")
    done = run_python(["-c", program, "batch", "share", "none.json", "0"], tmp_path)
    assert "none.json: cannot be read" in done.stderr


def test_jobs_take_nothing_that_is_executed_from_the_folder_of_results(tmp_path, monkeypatch):
    submitted = tmp_path / "sbatch"
    submitted.write_text('#!/bin/sh\npwd\necho "$1"\necho "$NUMBA_CACHE_DIR"\n')
    submitted.chmod(0o700)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "mine")
    monkeypatch.chdir(tmp_path)
    description = described(tmp_path / "out", 3, "slurm")
    description.write()
    place, name, kernels = description.submit().splitlines()
    assert (place, name) == (str(description.path.parent), description.path.name)
    assert kernels == str(tmp_path / "mine")
    for scheduler in ("slurm", "htcondor"):
        assert str(tmp_path) not in described(tmp_path / "out", 3, scheduler).text
    monkeypatch.setattr(jobs.sys, "executable", "/a\nqueue/python")
    for scheduler in ("slurm", "htcondor"):
        with pytest.raises(TrackerError, match="line break"):
            described(tmp_path, 3, scheduler)


def listing(output: str, log: str = "/in/a") -> str:
    return json.dumps({"options": OPTIONS.plain(), "recordings": [[log, output]]})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        *((text, "no batch") for text in ("", "{}", "[]", '{"recordings": [[1]]}')),
        ('{"options": 3, "recordings": []}', "no batch"),
        *((listing(output), "below the folder") for output in ("/home/a.poses.h5", "../a.poses.h5", "a.sh")),
        (listing("a.poses.h5", "/in/a\0"), "null byte"),
        (listing("a.poses.h5", "/in/\ud800"), "no batch"),
        (listing("b/../../a.poses.h5"), "below the folder"),
    ],
)
def test_a_list_that_is_none_or_leads_out_of_the_folder_of_results_is_refused(content, words, tmp_path):
    (tmp_path / "batch.json").write_text(content)
    with pytest.raises(LogError, match=words):
        read_batch(tmp_path)
    with pytest.raises(LogError, match=words):
        jobs.do_share(tmp_path / "batch.json", 0)
