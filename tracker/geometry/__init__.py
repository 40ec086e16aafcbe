"""Rotations, poses, cameras and cuboids: the mathematics, without objects or images."""
