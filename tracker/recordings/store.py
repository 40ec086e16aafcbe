"""Finished parts of a recording, kept beside the output until all are there."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tracker.errors import LogError
from tracker.files import write_whole
from tracker.logs.poses import Poses
from tracker.logs.poses_file import read_poses, write_poses
from tracker.recordings.parts import Part

_FINGERPRINT = "fingerprint.json"


class PartStore:
    """Files of poses in a folder, one for each finished part; the folder comes with the first `prepare`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def prepare(self, fingerprint: dict[str, Any]) -> None:
        """Keep what an earlier run of the same fingerprint left, and drop all else.

        Raises:
            OSError: the folder cannot be made or emptied.
        """
        content = json.dumps(fingerprint, indent=1)
        kept = self._folder / _FINGERPRINT
        with suppress(OSError, ValueError):  # ValueError: no UTF-8
            if kept.read_text(encoding="utf-8") == content:
                return
        if self._folder.exists():
            shutil.rmtree(self._folder)
        self._folder.mkdir()
        write_whole(kept, content)

    def missing(self, parts: Sequence[Part]) -> list[Part]:
        """The parts that are not there, or cannot be read."""
        return [part for part in parts if not self._is_whole(part)]

    def write(self, part: Part, poses: Poses, fault: str | None) -> None:
        """Keep a part, and what is wrong with the recording there.

        Raises:
            LogError: it cannot be written.
            OSError: the same.
        """
        # The part comes last: where it is, the fault is too.
        write_whole(self._fault_file(part), json.dumps(fault))
        write_poses(self._file(part), poses)

    def read(self, part: Part) -> tuple[Poses, str | None]:
        """What `write` was given.

        Raises:
            LogError: it is not there, or damaged.
        """
        try:
            fault = json.loads(self._fault_file(part).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise LogError(f"{self._fault_file(part)}: cannot be read: {error}") from error
        return read_poses(self._file(part)), fault

    def remove(self) -> None:
        """Forget everything; what cannot be removed stays."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _is_whole(self, part: Part) -> bool:
        try:
            poses, _ = self.read(part)
        except LogError:
            return False
        return all(part.start <= index < part.stop for index in poses.index.tolist())

    def _file(self, part: Part) -> Path:
        return self._folder / f"{part.number:06d}.h5"

    def _fault_file(self, part: Part) -> Path:
        return self._folder / f"{part.number:06d}.json"
