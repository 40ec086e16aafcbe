"""Track recordings again, and compare the poses with those that they contain."""

from pathlib import Path

import numpy as np

import tracker

for path in (Path("my_recording"), Path("tracker-demo")):  # thousands: `tracker batch`
    tracked = tracker.track(path, "cube_v2", output=f"{path.name}.poses.h5")  # or read it if it is there
    poses = tracked.poses
    sure = np.mean(poses.filtered.confidence > 0.9)  # NaN where there is no pose
    print(f"{path}: {len(poses)} frames, {100 * sure:.0f} % of them sure, {tracked.new} tracked now")
    if poses.recorded is not None:
        apart = np.linalg.norm(poses.filtered.position - poses.recorded.position, axis=1)
        print(f"  {1e3 * np.nanmedian(apart):.1f} mm from the recorded poses")
