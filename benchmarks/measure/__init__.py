"""Runs the tracker on scenes, films and recordings."""
