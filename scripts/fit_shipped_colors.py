"""Fit the colour models that come with the package to the platform's labelled images.

    python scripts/fit_shipped_colors.py REAL_FOLDER

REAL_FOLDER holds `pose/OBJECT`, `segmentation/OBJECT` and `dice`. Each object's model is fitted to its own
labelled images, with a small weight on those of the other objects. `simulation` is fitted to the pure colours
of the platform's simulation under shading; `dice` to the blue of one image. These two are fitted without
veils: the renderer has none, and the dice's mask follows the blue into shade anyway.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.data.recorded import SEGMENTED, labelled_images
from tracker.color_learning.fit import FitOptions, Histograms, combine, image_histograms
from tracker.color_learning.labelled import LabelledImage, read_image
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.color_model import ColorModel
from tracker.segmentation.light import apply_gains, find_light

DATA = Path(__file__).resolve().parent.parent / "tracker" / "segmentation" / "data"

UNVEILED = FitOptions(brightness=0.2, tail_width=4.0, shaded_share=0.0, reject=0.02)
"""Options without shade and veil, with more tints and twice the share of rejected colours."""

SIMULATION_RGB = {
    "red": (195, 48, 0),
    "green": (153, 208, 96),
    "blue": (4, 35, 96),
    "cyan": (116, 200, 191),
    "magenta": (164, 91, 164),
    "yellow": (255, 235, 108),
}


def simulation_image(seed: int = 0) -> LabelledImage:
    """Return a field of the simulation's colours under shading, with greys of all levels as background."""
    rng = np.random.default_rng(seed)
    size = 240
    image = np.empty((size, size, 3), np.uint8)
    labels = np.zeros((size, size), np.uint8)
    greys = rng.uniform(0, 255, (size, size, 1)) * np.exp(rng.normal(0, 0.03, (size, size, 3)))
    image[:] = np.clip(greys, 0, 255)
    for row, name in enumerate(SIMULATION_RGB):
        shade = rng.uniform(0.5, 1.2, (20, size, 1))
        block = slice(20 * row, 20 * row + 20)
        image[block] = np.clip(np.array(SIMULATION_RGB[name][::-1]) * shade, 0, 255)
        labels[block] = COLOR_NAMES.index(name)
    return LabelledImage("simulation", image, labels)


def dice_image(real: Path) -> LabelledImage:
    """Return the dice image; its mask is generous, so only its bluish pixels count as dice."""
    image = read_image(real / "dice" / "test_image.png")
    mask = read_image(real / "dice" / "test_mask.png").max(axis=2) > 0
    level = apply_gains(image, find_light(image).gains).astype(int)
    bluish = level[..., 0] > 1.3 * level[..., 2] + 15
    return LabelledImage("dice", image, np.where(mask & bluish, 3, 0).astype(np.uint8))


def face_histograms(
    images: dict[str, list[LabelledImage]], options: FitOptions
) -> dict[str, list[Histograms]]:
    """Return the histograms of labelled images, by object."""
    return {name: [image_histograms(image, options) for image in images[name]] for name in images}


def object_model(
    name: str, own: Sequence[Histograms], drawn_as_others: dict[str, list[Histograms]], options: FitOptions
) -> ColorModel:
    """Return an object's model from its images in `own` and, of `drawn_as_others`, those of other objects."""
    others = [h for other in drawn_as_others if other != name for h in drawn_as_others[other]]
    return combine(own, others, options, name=name)


def simulation_model() -> ColorModel:
    """Return the model of the simulation's colours."""
    options = dataclasses.replace(UNVEILED, brightness=0.12, channel=0.03, haze=2.0)
    # The field's greys are neutral by design, as in a normalised image.
    field = image_histograms(simulation_image(), options, normalise=False)
    return combine([field], (), options, name="simulation")


def dice_model(real: Path, histograms: dict[str, list[Histograms]]) -> ColorModel:
    """Return the model of the dice's blue against all backgrounds."""
    backgrounds = [{0: h[0]} for own in histograms.values() for h in own]
    dice = image_histograms(dice_image(real), UNVEILED)
    return combine([dice], backgrounds, UNVEILED, name="dice")


def main(real: Path) -> None:
    """Fit and write every model."""
    options, images = FitOptions(), {name: labelled_images(real, name) for name in SEGMENTED}
    histograms = face_histograms(images, options)
    drawn_as_others = face_histograms(images, options.for_others())
    models = [object_model(name, histograms[name], drawn_as_others, options) for name in SEGMENTED]
    for model in (*models, simulation_model(), dice_model(real, histograms)):
        model.save(DATA / f"{model.name}.npz")
    for path in sorted(DATA.glob("*.npz")):
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
