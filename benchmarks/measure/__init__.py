"""Runs the tracker on what is judged."""
