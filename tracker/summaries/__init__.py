"""Summaries of a tracked recording: numbers, rewards, remarks, and a table row."""
