"""Colours: an image becomes a label map, and tables of how likely each colour is."""

from tracker.segmentation.color_model import ColorModel, color_model_names, load_colors
from tracker.segmentation.labels import segment

__all__ = ["ColorModel", "color_model_names", "load_colors", "segment"]
