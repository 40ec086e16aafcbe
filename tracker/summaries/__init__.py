"""Summaries of a tracked recording: numbers, rewards, remarks, and a line of a table."""
