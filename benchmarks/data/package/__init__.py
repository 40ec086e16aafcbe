"""Scenes of the platform's own simulation package, drawn in an environment of its own."""
