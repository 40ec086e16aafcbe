"""Recordings that are folders of pictures, or films."""
