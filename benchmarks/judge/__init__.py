"""Compares figures with targets, with a baseline, and with another run."""
