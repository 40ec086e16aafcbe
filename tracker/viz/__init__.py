"""Visualisation: estimates drawn into their images, plots, and image files."""

from tracker.viz.dice import dice_overlay as dice_overlay
from tracker.viz.dice import goal_picture as goal_picture
from tracker.viz.image_files import IMAGE_SUFFIXES as IMAGE_SUFFIXES
from tracker.viz.image_files import write_film as write_film
from tracker.viz.image_files import write_image as write_image
from tracker.viz.overlays import overlay as overlay
from tracker.viz.plots import write_colors_plot as write_colors_plot
from tracker.viz.plots import write_trajectory_plot as write_trajectory_plot
