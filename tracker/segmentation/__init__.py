"""Colour segmentation: label maps from images, and the colour models behind them."""

from tracker.segmentation.color_model import ColorModel, color_model_names, load_colors
from tracker.segmentation.labels import segment

__all__ = ["ColorModel", "color_model_names", "load_colors", "segment"]
