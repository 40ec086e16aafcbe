"""Pictures for people: the estimate drawn into the images that it comes from, and their files."""

from tracker.viz.dice import dice_overlay, goal_picture
from tracker.viz.image_files import IMAGE_SUFFIXES, write_film, write_image
from tracker.viz.overlays import overlay
from tracker.viz.plots import write_colors_plot
from tracker.viz.trajectory import write_trajectory_plot

__all__ = [
    "IMAGE_SUFFIXES",
    "dice_overlay",
    "goal_picture",
    "overlay",
    "write_colors_plot",
    "write_film",
    "write_image",
    "write_trajectory_plot",
]
