"""Poses estimated in a recording: collecting, storing, comparing and exporting them."""
