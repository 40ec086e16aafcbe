import os
import signal
import sys
from concurrent.futures import Future
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from tracker.batch import workers
from tracker.batch.workers import ONE_THREAD, WorkerError, dask_workers, engine, here, processes
from tracker.errors import TrackerError


def held(_: object) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def environment(_: object) -> list[str | None]:
    return [os.environ.get(name) for name in ONE_THREAD]


def fail_once(mark: str) -> str:
    """End the process the first time, fail the second time."""
    path = Path(mark)
    if path.name == "always" or not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if path.name == "error":
        raise ZeroDivisionError(mark)
    return path.name


@pytest.fixture
def without_dask(monkeypatch):
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)


def test_who_ends_a_process_gets_another_and_only_the_task_that_does_it_always_fails(
    tmp_path, without_dask, monkeypatch
):
    monkeypatch.setattr(workers, "ATTEMPTS", 2)
    tasks = [str(tmp_path / name) for name in ("a", "always", "b", "error", "c")]
    with engine(2) as each:
        found = {Path(task).name: result for task, result in each(fail_once, tasks)}
    assert [found[name] for name in "abc"] == ["a", "b", "c"]
    assert isinstance(found["error"], ZeroDivisionError)
    assert isinstance(found["always"], WorkerError)


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="system: no masks of signals")
def test_a_worker_has_one_thread_never_sees_ctrl_c_and_goes_on_after_what_cannot_be_sent(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    before = environment(None)
    with processes(1) as each:
        ((_, error),) = each(memoryview, [b"a"])
        assert isinstance(error, WorkerError)
        assert list(each(held, [0])) == [(0, True)]
        assert list(each(environment, [0])) == [(0, ["1"] * len(ONE_THREAD))]
    assert environment(None) == before
    assert not held(None)


def test_tasks_are_taken_as_they_are_needed():
    taken = []
    with processes(1) as each:
        for task, result in each(abs, (taken.append(k) or k for k in range(20))):
            assert result == task
            assert len(taken) <= task + 2 * workers.AHEAD
    assert len(taken) == 20


def test_only_a_scheduler_of_others_needs_what_the_core_has_not(without_dask):
    with (
        pytest.raises(TrackerError, match=r"--scheduler needs the package (dask|distributed).*cluster"),
        dask_workers("x"),
    ):
        pass
    with engine(1) as each:
        assert each is here


def test_a_scheduler_that_is_lost_is_named(monkeypatch):
    distributed = pytest.importorskip("distributed", reason="cluster: no module distributed")
    client, future = MagicMock(), Future()
    future.cancel()
    future.set_running_or_notify_cancel()
    client.nthreads.return_value = {"worker": 1}
    client.get_executor.return_value.submit.return_value = future
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: client)
    with (
        dask_workers("tcp://127.0.0.1:9") as each,
        pytest.raises(TrackerError, match=r"scheduler tcp:.*: was lost"),
    ):
        list(each(abs, [1]))
