"""Tracks many recordings, each once, in several processes or machines, and makes one table of results."""
