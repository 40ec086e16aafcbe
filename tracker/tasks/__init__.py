"""The platform's tasks: how far a state is from its goal."""

from tracker.tasks import move_object as move_object
from tracker.tasks import rearrange_dice as rearrange_dice
