"""The platform's tasks: how far a state is from its goal."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tracker.tasks import move_object as move_object
    from tracker.tasks import rearrange_dice as rearrange_dice
else:

    def __getattr__(name):
        if name not in ("move_object", "rearrange_dice"):
            raise AttributeError(f"module 'tracker.tasks' has no attribute {name!r}")
        # Import on first use: errors and rewards do not need the image processing for dice.
        return import_module(f"tracker.tasks.{name}")
