"""Recordings of the platform, and the poses that were found in them."""
