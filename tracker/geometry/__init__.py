"""Geometry of rotations, poses, cameras and cuboids, independent of object models and images."""

from tracker.geometry import so3 as so3
