"""Comparison of figures with targets, with a baseline, and with another run."""
