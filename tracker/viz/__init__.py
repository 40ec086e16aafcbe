"""Pictures for people: the estimate drawn into the images that it comes from, and their files."""

from tracker.viz.files import IMAGE_SUFFIXES, write_image
from tracker.viz.film import write_film
from tracker.viz.overlays import overlay

__all__ = ["IMAGE_SUFFIXES", "overlay", "write_film", "write_image"]
