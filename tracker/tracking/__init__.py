"""Tracking over time: the motion filter, which measurements to accept, and the state between frames."""
