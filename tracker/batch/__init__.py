"""Tracks many recordings, divided among processes and machines, each once, with one table of results."""
