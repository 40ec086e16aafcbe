"""Lenses and places of cameras, from photos of a board."""
