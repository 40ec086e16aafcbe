"""Tracks parts of a recording, in whatever process."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence

from tracker.errors import LogError, TrackerError
from tracker.logs import Log, LogFrame, open_log
from tracker.logs.poses_builder import Answer, PosesBuilder
from tracker.recordings.job import Job, MovingTracker
from tracker.recordings.parts import RUN_UP, Part
from tracker.recordings.store import PartStore

Tick = Callable[[], None]
"""Called after each frame of a part; what it raises ends the work."""


class PartTracker:
    """Makes a tracker and opens the recording once, for any number of parts.

    Raises:
        TrackerError: the tracker cannot be made.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._tracker: MovingTracker = job.make_tracker(job.model, job.rig, job.colors)
        self._store = PartStore(job.parts_folder)
        self._log: Log | None = None
        self._episode = -1

    def track(self, run: Sequence[Part], tick: Tick) -> None:
        """Track parts in the order of their numbers, and store each as soon as it is finished.

        Raises:
            LogError: the recording is damaged and not to be recovered, or a part cannot be stored.
            TrackerError: the tracker does not take the images.
        """
        log = self._opened()
        frames = iter(log[run[0].run_up : run[-1].stop])
        # Only where another part follows its frames are needed again.
        recent: deque[LogFrame] = deque(maxlen=RUN_UP if len(run) > 1 else 0)
        ahead = next(frames, None)
        for part in run:
            self._tracker.reset()
            self._episode = -1
            poses = PosesBuilder(self._job.about)
            for frame in recent:
                if frame.index >= part.run_up:
                    self._update(frame, log)
            while ahead is not None and ahead.index < part.stop:
                if ahead.index >= part.run_up:
                    answer = self._update(ahead, log)
                    if ahead.index >= part.start:
                        poses.append(ahead.index, ahead.timestamp, answer, ahead.recorded_pose)
                        tick()
                recent.append(ahead)
                ahead = next(frames, None)
            self._store.write(part, poses.build(), log.fault)

    def close(self) -> None:
        """Close the recording."""
        if self._log is not None:
            self._log.close()
            self._log = None

    def _opened(self) -> Log:
        # A log remembers the faults it has met; those of one part must not be told of another.
        if self._log is None or self._job.recover:
            self.close()
            self._log = open_log(self._job.log, recover=self._job.recover)
        return self._log

    def _update(self, frame: LogFrame, log: Log) -> Answer:
        episode = bisect_right(log.episode_starts, frame.index)
        if self._episode not in (-1, episode):
            self._tracker.reset()
        self._episode = episode
        try:
            return self._tracker.update(frame.images, frame.timestamp)
        except TrackerError as error:
            raise LogError(f"{self._job.log}: frame {frame.index}: {error}") from error
