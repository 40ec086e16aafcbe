"""Calibration files: the platform's cameras and the arena."""
