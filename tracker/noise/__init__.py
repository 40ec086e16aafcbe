"""Simulation of the tracker's errors: noisy poses from true ones, for many environments at once."""

from tracker.noise.model import NoiseModel, NoiseState, Number, Seen

__all__ = ["NoiseModel", "NoiseState", "Number", "Seen"]
