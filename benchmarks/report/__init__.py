"""Presents results as documents and plots."""
