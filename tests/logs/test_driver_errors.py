"""What the platform's recorder leaves of a driver's error: a record of zeros."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import tracker
from tests.helpers.log_writers import Content, make_content, write_hdf5, write_native, write_picture
from tests.helpers.recording_stubs import write_log
from tracker.recordings import track


def with_errors(frames: list[int], count: int = 8) -> Content:
    content = make_content(count)
    raw, stamps, camera_stamps = content.raw.copy(), content.stamps.copy(), content.camera_stamps.copy()
    raw[frames], stamps[frames], camera_stamps[frames] = 0, 0, 0
    return dataclasses.replace(content, raw=raw, stamps=stamps, camera_stamps=camera_stamps)


@pytest.mark.parametrize("write", [write_native, write_hdf5])
@pytest.mark.parametrize("frames", [[3], [3, 4], [0], [0, 1], [7], [6, 7], [0, 4, 7], list(range(8))])
def test_an_empty_record_is_a_frame_without_images(write, frames, tmp_path):
    content = with_errors(frames)
    with tracker.open_log(write(tmp_path / "log", content)) as log:
        read = list(log)
        alone = log[frames[0]]
    assert [frame.index for frame in read] == list(range(8))
    for frame in read:
        if frame.index in frames:
            assert frame.images == (None,) * 3
            assert np.isnan(frame.camera_timestamps).all()
            assert frame.recorded_pose is None
        else:
            assert frame.timestamp == pytest.approx(content.stamps[frame.index], abs=1e-6)
            assert (frame.images[1] == content.bgr(frame.index, 1)).all()
    assert (np.diff([frame.timestamp for frame in read]) > 0).all()
    assert np.isnan(alone.timestamp)


def test_a_recording_with_an_empty_record_is_tracked_on(tmp_path, run_here):
    log = write_log(tmp_path / "log", 8)
    write_native(log, with_errors([3, 4]), poses=1)
    poses = track(log, "cube_v2").poses
    assert poses.index.tolist() == list(range(8))
    found = json.loads(run_here("info", log, "--json").stdout)
    assert found["without_image"] == {"camera60": 2, "camera180": 2, "camera300": 2}


def test_black_pictures_with_stamps_are_pictures(tmp_path):
    content = make_content(3)
    black = dataclasses.replace(content, raw=np.zeros_like(content.raw))
    with tracker.open_log(write_native(tmp_path / "log", black)) as log:
        assert not any(image.any() for frame in log for image in frame.images)


def test_a_loose_picture_does_not_hide_the_folders(tmp_path, rng):
    for name in ("camera60", "camera180"):
        for number in range(3):
            image = rng.integers(0, 255, (24, 28, 3), np.uint8)
            write_picture(tmp_path / "imgs" / name / f"{number:06d}.png", image)
    write_picture(tmp_path / "imgs" / "camera60_overlay.png", np.zeros((50, 50, 3), np.uint8))
    with tracker.open_log(tmp_path / "imgs") as log:
        assert len(log) == 3
        assert log.camera_names == ("camera60", "camera180")
