"""Least squares over the edges: a pose, what is unknown with it, and how certain it is."""
