"""Measure the cameras of recorded images, and compare rendered images with them.

    python scripts/measure_cameras.py REAL_FOLDER [--scenes N] [--effects NAMES]

REAL_FOLDER holds `pose/OBJECT`, `segmentation/OBJECT`, `dice` and `charuco`. Prints the camera measurements
of each image, the figures behind the distributions of `synthetic.camera`, and the medians of recorded and
rendered images of the same kind side by side.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from camera_measures import (
    CHANNELS,
    block_ratio,
    edges,
    fringes,
    is_mosaic,
    noise_curve,
    noise_spectrum,
    planes,
    response_exponent,
    vignetting,
)
from PIL import Image as Files

from synthetic.effects import NAMES, chosen_effects
from synthetic.frames import frames
from tracker.conventions import FloatArray, Image

SEED = 60_613
"""Seed of the rendered images; different from those of any evaluation."""

KINDS = {"540, new": ("cube_v2", 540, "new"), "270, old": ("cuboid_2x2x8_v2", 270, "old")}
"""Kinds of recorded images: object, height [px] and path of the corresponding rendered ones."""

LIKE_RECORDED = tuple(
    name for name in NAMES if name not in ("sharpening", "calibration", "compression", "timing")
)
"""Effects that recorded mosaics show: nothing sharpened or compressed them, and nothing moved."""

LEVELS = (40, 80, 120)
"""Levels at which noise is reported [steps of 8 bits]."""

SHARP = 25
"""Percentile of the blurs of an image's edges that is attributed to the lens: most edges are round or shaded,
few are sharp."""


def measure(image: Image) -> dict[str, float]:
    """Return all measurements of an image."""
    result: dict[str, float] = {}
    for channel, name in enumerate(CHANNELS):
        found = [edge for edge in edges(image, channel, 250) if edge is not None]
        sigmas = [edge.sigma for edge in found]
        sharp = [edge for edge in found if edge.sigma < 1.0]
        result[f"blur {name}"] = float(np.percentile(sigmas, SHARP)) if len(sigmas) >= 8 else np.nan
        over = np.array([edge.over for edge in sharp]).reshape(-1, 2)
        for side, title in enumerate(("dark", "bright")):
            known = over[np.isfinite(over[:, side]), side]
            result[f"over {title} {name}"] = float(np.median(known)) if len(known) >= 5 else np.nan
        curve = noise_curve(image, channel)
        result[f"exponent {name}"] = response_exponent(curve)
        for level in LEVELS:
            near = [noise for at, noise, _ in curve if abs(at - level) < 12]
            result[f"noise {level} {name}"] = float(np.mean(near)) if near else np.nan
        for ring, share in enumerate(noise_spectrum(image, channel)):
            result[f"spectrum {ring} {name}"] = float(share)
        result[f"black {name}"] = float(np.mean([np.mean(plane == 0) for plane in planes(image, channel)]))
    result["blocks"] = block_ratio(image)
    return result


def recorded(real: Path) -> dict[str, dict[str, Image]]:
    """Return images of each kind by name, if they are mosaics to the bit."""
    paths = [*sorted(real.glob("pose/*/camera*.png")), *sorted(real.glob("segmentation/*/*_image.png"))]
    result: dict[str, dict[str, Image]] = {kind: {} for kind in KINDS}
    for path in [*paths, real / "dice" / "test_image.png"]:
        image = np.asarray(cv2.imread(str(path)), dtype=np.uint8)
        if is_mosaic(image):
            kind = "540, new" if image.shape[0] > 400 else "270, old"
            result[kind][f"{path.parent.name}/{path.stem}"] = image
    return result


def rendered(kind: str, scenes: int, effects: str) -> dict[str, Image]:
    """Return images of all cameras for some scenes."""
    name, size, path = KINDS[kind]
    made = frames(name, scenes, SEED, size=size, path=path, empty=0.0, effects=chosen_effects(effects))
    return {f"{frame.index}/{c}": image for frame in made for c, image in enumerate(frame.images)}


def _medians(rows: Iterable[dict[str, float]]) -> dict[str, float]:
    listed = list(rows)
    result = {}
    for key in listed[0]:
        known = [row[key] for row in listed if np.isfinite(row[key])]
        result[key] = float(np.median(known)) if known else np.nan
    return result


def print_pictures(rows: dict[str, dict[str, float]]) -> None:
    """Print one line for each image; three values are those of blue, green and red."""
    heads = "blur [px] | over dark | over bright | exponent | noise at 40 | at 120 | share of 0 | blocks"
    print(f"| picture | {heads} |\n|---|---|---|---|---|---|---|---|---|")
    for name, row in rows.items():
        cells = []
        for key in ("blur", "over dark", "over bright", "exponent", "noise 40", "noise 120", "black"):
            cells.append(", ".join(f"{row[f'{key} {channel}']:.2f}" for channel in CHANNELS))
        print(f"| {name} | {' | '.join(cells)} | {row['blocks']:.2f} |")


def print_photos(real: Path) -> None:
    """Print measurements of the board's photos: they are neutral, sharp, and the board covers all of them."""
    paths = sorted(real.glob("charuco/intrinsic_camera/*.jpeg"))
    falls, shifts = [], []
    for path in paths:
        image = np.asarray(cv2.imread(str(path)), dtype=np.uint8)
        falls.append(vignetting(image))
        red = fringes(image, 2, 250)
        if red is not None and red[1][2] < 0.05:
            shifts.append(red[0][2])
    tables = {tuple(Files.open(path).quantization[0][:8]) for path in paths}  # type: ignore[attr-defined]
    quality = [q for q in range(50, 101) if _table(q) in tables]
    print(f"{len(paths)} photos of the board, 540 px high")
    print(f"  quality of their JPEG: {quality}")
    print(f"  light lost at half the height from the centre: {_spread(np.array(falls))}")
    found = f"{len(shifts)} photos [px]: {_spread(np.array(shifts))}"
    print(f"  red edges further out than green ones there, {found}")


def _table(quality: int) -> tuple[int, ...]:
    """Return the first entries of the luma table of a JPEG of this quality, in the file's order."""
    base = np.array([16, 11, 10, 16, 24, 40, 51, 61])
    scale = 5000 // quality if quality < 50 else 200 - 2 * quality
    return tuple(np.clip((base * scale + 50) // 100, 1, 255).tolist())


def _spread(values: FloatArray) -> str:
    known = values[np.isfinite(values)]
    low, middle, high = np.percentile(known, [10, 50, 90])
    return f"{middle:.3f}, 10th and 90th percentile {low:.3f} and {high:.3f}"


def print_comparison(title: str, real: dict[str, float], made: dict[str, float]) -> None:
    """Print medians of recorded and of rendered images, and their ratios."""
    print(f"\n| {title} | recorded | rendered | ratio |\n|---|---|---|---|")
    for key in real:
        if not key.startswith(("over", "black", "exponent")):
            print(f"| {key} | {real[key]:.3f} | {made[key]:.3f} | {made[key] / real[key]:.2f} |")


def main() -> None:
    """Print every table."""
    parser = argparse.ArgumentParser(description="Measure cameras.")
    parser.add_argument("real", type=Path)
    parser.add_argument("--scenes", type=int, default=0, help="rendered scenes of each kind")
    parser.add_argument("--effects", default=",".join(LIKE_RECORDED), help="of the rendered pictures")
    options = parser.parse_args()
    print_photos(options.real)
    for kind, images in recorded(options.real).items():
        print(f"\nRecorded, {kind}")
        rows = {name: measure(image) for name, image in images.items()}
        print_pictures(rows)
        if options.scenes:
            own = {k: measure(i) for k, i in rendered(kind, options.scenes, options.effects).items()}
            print(f"\nRendered, {kind}, effects {options.effects}")
            print_pictures(own)
            print_comparison(kind, _medians(rows.values()), _medians(own.values()))


if __name__ == "__main__":
    main()
