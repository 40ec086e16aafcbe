"""Lenses and poses of cameras, from photos of a board."""
