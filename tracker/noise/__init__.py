"""The tracker's errors, for simulators: noisy poses from true ones, for many environments at once."""

from tracker.noise.model import NoiseModel, Number
from tracker.noise.state import NoiseState, Seen

__all__ = ["NoiseModel", "NoiseState", "Number", "Seen"]
