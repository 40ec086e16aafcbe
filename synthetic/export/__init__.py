"""Data sets and other files made from frames."""
