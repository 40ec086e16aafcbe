"""Pieces of the object's visible edges, and where the pictures show them."""
