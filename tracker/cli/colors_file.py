"""Files of colour models that commands write."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tracker.errors import ColorModelError

if TYPE_CHECKING:
    from tracker.segmentation.color_model import ColorModel


def check_colors_file(target: Path) -> None:
    """Refuse, before anything is computed, what `save_colors` could not write."""
    if target.suffix != ".npz":
        raise ColorModelError(f"colour model {target}: found suffix {target.suffix!r}, expected .npz")
    if not target.parent.is_dir():
        raise ColorModelError(f"colour model {target}: there is no folder {target.parent}")


def save_colors(model: ColorModel, target: Path) -> None:
    """Write a colour model; ColorModelError where that fails."""
    try:
        model.save(target)
    except OSError as error:
        raise ColorModelError(f"colour model {target}: cannot be written: {error.strerror}") from error
