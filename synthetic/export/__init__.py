"""Data sets and other files made of frames."""
