"""Try an object of your own on synthetic images before it is built."""

from pathlib import Path

import numpy as np

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.stills import bare_scene, take

Path("my_box.toml").write_text("""
name = "my_box"
size = [0.09, 0.045, 0.03]  # [m]
colors = "simulation"       # of real ones: `tracker colors new`

[faces]
"+x" = "red"
"-x" = "magenta"
"+y" = "green"
"-y" = "yellow"
"+z" = "blue"
"-z" = "cyan"
""")
model = tracker.load_object("my_box.toml")
rig = tracker.CameraRig(default_cameras())
finder = tracker.ObjectTracker(model, rig)
for seed in range(3):
    rng = np.random.default_rng(seed)
    still = take(bare_scene(model, rng), rig.cameras, Sensor.realistic(), rng)
    pose = finder.detect(still.images).object_pose
    if pose is None:
        print("not found")
    else:
        distance = np.linalg.norm(pose.position - still.position)
        print(f"{1e3 * distance:.2f} mm from the truth, confidence {pose.confidence:.2f}")
