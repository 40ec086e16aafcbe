"""Geometry of rotations, poses, cameras and cuboids, independent of object models and images."""
