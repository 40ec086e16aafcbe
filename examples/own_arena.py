"""Look for the object in an arena of your own."""

import dataclasses

import tracker

rig = tracker.CameraRig.load("tracker-demo")
arena = tracker.Arena(center=(0.0, 0.0), radius=0.2, height=0.15, table=0.0)  # [m]
rig = dataclasses.replace(rig, arena=arena)
