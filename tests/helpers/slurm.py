"""A Slurm of one machine with two places, in a folder and on ports of its own."""

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.needs import lack
from tracker.processes import environment

COMMANDS = ("slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel", "sinfo")
SECONDS = 90
"""For so long something may take to happen [s]."""

CONFIGURATION = """\
ClusterName=test
SlurmctldHost=localhost
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SchedulerType=sched/builtin
SchedulerParameters=batch_sched_delay=0,sched_interval=1
SlurmdParameters=config_overrides
KillWait=2
NodeName=localhost CPUs=2 RealMemory=4000
PartitionName=all Nodes=localhost Default=YES State=UP
"""
"""Without the service that tells users from each other, which would have to run as one of its own. A job
that is begun again waits until the permission of its first attempt is void (`cred_expire`)."""


@dataclass(frozen=True)
class Slurm:
    """Its configuration is in SLURM_CONF of this process."""

    folder: Path

    def ask(self, *command: str) -> str:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=SECONDS).stdout

    def jobs(self) -> list[str]:
        """A line for each job that waits or runs."""
        return self.ask("squeue", "--noheader", "--array").splitlines()

    def finish(self) -> None:
        """Wait until nothing waits or runs."""
        until(lambda: not self.jobs(), self.folder)


def until(holds: Callable[[], object], logs: Path) -> None:
    """Wait until something holds.

    Raises:
        AssertionError: it never does; with what the logs of a folder say last.
    """
    deadline = time.monotonic() + SECONDS
    while not holds():
        if time.monotonic() > deadline:
            raise AssertionError("\n".join(path.read_text()[-2000:] for path in sorted(logs.glob("*.log"))))
        time.sleep(0.05)


@contextlib.contextmanager
def single_node(folder: Path) -> Iterator[Slurm]:
    """One that runs until the `with` block ends; the test is skipped where there can be none."""
    # Services are where only the administrator looks.
    path = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin"])
    found = {command: shutil.which(command, path=path) for command in COMMANDS}
    missing = [command for command, place in found.items() if place is None]
    if missing:
        lack("slurm", f"no {', '.join(missing)}; Debian's package is slurm-wlm")
    for name in ("state", "spool"):
        (folder / name).mkdir()
    user, configuration = folder.owner(), folder / "slurm.conf"
    configuration.write_text(CONFIGURATION.format(folder=folder, ports=_free_ports(), user=user))
    daemons: list[subprocess.Popen[bytes]] = []
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with environment({"SLURM_CONF": str(configuration)}):
        try:
            for command in ([found["slurmctld"], "-D", "-i"], [found["slurmd"], "-D", "-N", "localhost"]):
                daemons.append(subprocess.Popen(command, **silent))
            _wait_for_node(folder, daemons)
            yield Slurm(folder)
            subprocess.run(["scancel", f"--user={user}"], check=False, timeout=SECONDS)
            Slurm(folder).finish()
        finally:
            for daemon in reversed(daemons):
                daemon.terminate()
                daemon.wait(SECONDS)


def _wait_for_node(folder: Path, daemons: list[subprocess.Popen[bytes]]) -> None:
    """Skip the test if the daemons end, or the node is not ready in time."""
    deadline = time.monotonic() + SECONDS / 3
    asked = ["sinfo", "--noheader", "--format=%t"]
    while subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() != "idle":
        if any(daemon.poll() is not None for daemon in daemons) or time.monotonic() > deadline:
            lines = [line for path in folder.glob("*.log") for line in path.read_text().splitlines()]
            lack("slurm", f"cannot be started: {[line for line in lines if 'fatal' in line] or lines[-3:]}")
        time.sleep(0.1)


def _free_ports() -> list[int]:
    with socket.socket() as one, socket.socket() as other:
        for each in (one, other):
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in (one, other)]
