"""Tracks many recordings, each once, by several processes or machines, and makes one table of results."""
