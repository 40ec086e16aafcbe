"""Test how live tracking survives faults while it runs, each fault ten times.

    python scripts/live_faults.py [--times N] [--away SECONDS]

Simulated cameras show a film of the simulated platform. Faults affect the cameras, a subscriber, the disk, or
end the whole process. Printed for each: whether tracking continues, its statuses during the fault, and after
how many complete sets of images the object is found again; for recordings, how much is lost.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import tracker
from tracker.errors import LiveError
from tracker.live import CameraSet, Live, Moment, Simulation
from tracker.live.cameras import CameraLost, Grabbed
from tracker.live.listeners import Recorder
from tracker.live.publishers import ZmqPublisher
from tracker.logs.hdf5_writer import Hdf5LogWriter

parser = argparse.ArgumentParser(description="Break things while something is tracked.")
parser.add_argument("--times", type=int, default=10, help="how often each (default: 10)")
parser.add_argument("--away", type=float, default=5.0, help="how long a camera is gone [s] (default: 5)")
parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)


class Faults:
    """The current faults of the simulated cameras."""

    def __init__(self) -> None:
        self.state: dict[int, str] = {}
        self.off: dict[int, float] = {}


class Pretended:
    """A simulated camera that shows a film, or its fault."""

    triggered = True

    def __init__(self, number: int, film: list[tracker.conventions.Image], faults: Faults) -> None:
        self._number, self._film, self._faults = number, film, faults
        self._rng, self._last = np.random.default_rng(number), film[0]
        if faults.state.get(number) == "gone":
            raise LiveError("it is not there")

    def grab(self, timeout: float) -> Grabbed:
        """See `tracker.live.cameras.LiveCamera`."""
        state, now = self._faults.state.get(self._number), time.time()
        if state == "failed":
            del self._faults.state[self._number]
            raise LiveError("the buffer failed")
        if state == "gone":
            raise CameraLost("it does not answer")
        if state != "frozen":
            image = self._film[int(10 * now) % len(self._film)].astype(np.int16)
            self._last = np.clip(image + self._rng.integers(-2, 3, image.shape), 0, 255).astype(np.uint8)
        return Grabbed(self._last, now + self._faults.off.get(self._number, 0.0))

    def settings(self) -> dict[str, str | int | float | bool]:
        """See `tracker.live.cameras.LiveCamera`."""
        return {}

    def close(self) -> None:
        """See `tracker.live.cameras.LiveCamera`."""


class Run:
    """Live tracking with the simulated cameras, and all its moments."""

    def __init__(self, film: Simulation, listeners: list[Callable[[Moment], None]]) -> None:
        self.faults, self.moments = Faults(), list[Moment]()
        film.draw()
        sets = film._sets
        openers = [
            lambda c=c: Pretended(c, [images[c] for images in sets], self.faults)
            for c in range(len(film.rig))
        ]
        sizes = [(camera.width, camera.height) for camera in film.rig]
        follower = tracker.ObjectTracker(tracker.load_object("cube_v2"), film.rig)
        self.live = Live(CameraSet(openers, sizes), follower, listeners=[self.moments.append, *listeners])
        self.live.wait(after=5, timeout=60)

    def fault(
        self, name: str, times: int, seconds: float, state: str = "", off: float = 0.0, cameras: int = 1
    ) -> None:
        """Cause a fault, and print its effects."""
        needed, statuses, faults = [], set[str](), dict[str, str]()
        for _ in range(times):
            before = len(self.moments)
            for camera in range(cameras):
                if state:
                    self.faults.state[camera] = state
                self.faults.off[camera] = off
            time.sleep(seconds)
            during = self.moments[before:]
            statuses |= {
                f"{m.status.value} ({', '.join(sorted(u.value for u in m.cameras))})" for m in during[1:]
            }
            for moment in during:
                faults.update(moment.faults)
                if moment.jump is not None:
                    faults["stamps"] = moment.jump
            self.faults.state.clear()
            self.faults.off.clear()
            after = len(self.moments)
            time.sleep(2.5)
            clear = [m for m in self.moments[after:] if all(image is not None for image in m.taken.images)]
            needed.append(next((n for n, m in enumerate(clear, 1) if m.object_pose is not None), None))
        going = "goes on" if self.live.running else f"has ended: {self.live.error}"
        print(
            f"{name}: {going}; posed in set {needed} of a clear view; statuses {sorted(statuses)}, {faults}",
            flush=True,
        )


def hanging(film: Simulation, times: int) -> None:
    """Test subscribers that connect and read nothing."""
    publisher = ZmqPublisher("tcp://127.0.0.1:*")
    host, port = publisher.address.removeprefix("tcp://").split(":")
    run = Run(film, [publisher])
    hung = [socket.create_connection((host, int(port))) for _ in range(times)]
    before = len(run.moments)
    time.sleep(3.0)
    print(f"{times} subscribers that hang: {len(run.moments) - before} sets in 3 s")
    run.live.close()
    publisher.close()
    for one in hung:
        one.close()


def full_disk(film: Simulation, times: int, folder: Path) -> None:
    """Test a disk that is full after some frames."""
    append, kept = Hdf5LogWriter.append, []

    def limited(writer: Hdf5LogWriter, *arguments: object) -> None:
        if len(writer) >= 5:
            raise tracker.errors.LogError("No space left on device")
        append(writer, *arguments)  # type: ignore[arg-type]

    Hdf5LogWriter.append = limited  # type: ignore[assignment, method-assign]
    try:
        for number in range(times):
            path = folder / f"full{number}.h5"
            recorder = Recorder(path, film.rig)
            run = Run(film, [recorder])
            run.live.wait(after=12, timeout=60)
            assert run.live.running
            run.live.close()
            recorder.close()
            with tracker.open_log(path) as log:
                kept.append(len(list(log)))
    finally:
        Hdf5LogWriter.append = append  # type: ignore[method-assign]
    print(f"disk full: tracking goes on; frames in the files, of 5 before it was full: {kept}", flush=True)


def killed(times: int, folder: Path) -> None:
    """Test kill -9 of a process that records."""
    lost = []
    for number in range(times):
        path = folder / f"killed{number}.h5"
        command = [sys.executable, __file__, "--record", str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                last = json.loads(line)
                if last["sequence"] >= 25 + 3 * number:
                    break
            os.kill(process.pid, signal.SIGKILL)
        with tracker.open_log(path) as log:
            stamps = [frame.timestamp for frame in log]
        lost.append(round(last["timestamp"] - stamps[-1], 2))
    print(f"killed: every file opens; seconds of the recording that are lost: {lost}", flush=True)


def record(path: Path) -> None:
    """Record forever; run by `killed`."""
    film = Simulation("cube_v2", frames=2)
    recorder = Recorder(path, film.rig)
    print_moment = lambda m: print(json.dumps({"sequence": m.sequence, "timestamp": m.timestamp}), flush=True)  # noqa: E731
    run = Run(film, [recorder, print_moment])
    while run.live.running:
        time.sleep(1.0)


def main(times: int, away: float) -> None:
    """Test all faults."""
    film = Simulation("cube_v2", frames=12)
    run = Run(film, [])
    run.fault("a failed buffer", times, 0.3, "failed")
    run.fault(f"a camera gone for {away:g} s", times, away, "gone")
    run.fault(f"two cameras gone for {away:g} s", times, away, "gone", cameras=2)
    run.fault("a frozen picture", times, 1.0, "frozen")
    run.fault("a camera's stamps jump by 7 s", times, 0.5, off=7.0)
    run.fault("all stamps jump by 7 s", times, 0.5, off=7.0, cameras=3)
    run.fault("all stamps jump back by 7 s", times, 0.5, off=-7.0, cameras=3)
    run.live.close()
    hanging(film, times)
    with tempfile.TemporaryDirectory() as folder:
        full_disk(film, times, Path(folder))
        killed(times, Path(folder))


if __name__ == "__main__":
    arguments = parser.parse_args()
    if arguments.record is not None:
        record(arguments.record)
    else:
        main(arguments.times, arguments.away)
