"""Compare recorded images with rendered ones of the same poses, calibrations and light: a sheet and a table.

    python scripts/compare_with_recorded.py REAL_FOLDER -o sheet.png [--effects world] [--draws N]

The sheet shows every recorded triplet above one that is rendered like it, with the objects enlarged. The
table has medians over all edges and images, and the ratio of rendered to recorded.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import click
import cv2
import numpy as np
from camera_measures import noise_curve, noise_spectrum
from measure_edges import EdgeProfile, edge_profiles
from restage import POSED, Triplet, recorded, redrawn

import tracker
from tracker.conventions import Image
from tracker.geometry.cuboid import corners

CELL = 400
"""Side of the sheet's images [px]."""

KINDS = {"cubes, 540 px": ("cube_v1", "cube_v2"), "cuboid, 270 px": ("cuboid_2x2x8_v2",)}

_LEVELS = (24.0, 110.0)
"""Levels of green at which noise is compared."""


def sheet(pairs: Sequence[tuple[Triplet, Triplet]]) -> Image:
    """Return recorded images with rendered ones below, and the objects enlarged beside them."""
    rows = []
    for triplets in pairs:
        for triplet in triplets:
            whole = [cv2.resize(v.image, (CELL, CELL), interpolation=cv2.INTER_AREA) for v in triplet.views]
            near = [
                cv2.resize(_around(triplet, k), (CELL, CELL), interpolation=cv2.INTER_NEAREST)
                for k in range(3)
            ]
            rows.append(np.hstack([*whole, *near]))
    return np.asarray(np.vstack(rows))


def _around(triplet: Triplet, view: int) -> Image:
    camera, image = triplet.views[view].camera, triplet.views[view].image
    points = camera.project(corners(triplet.model.size) @ triplet.rotation.T + triplet.position)
    half = int(np.ptp(points, axis=0).max() * 0.62)
    x, y = points.mean(axis=0).astype(int)
    x, y = (int(np.clip(c, half, n - half)) for c, n in ((x, image.shape[1]), (y, image.shape[0])))
    return image[y - half : y + half, x - half : x + half]


def fitted(triplet: Triplet) -> Triplet:
    """Return the triplet with the pose that the tracker estimates from its images."""
    rig = tracker.CameraRig(tuple(view.camera for view in triplet.views))
    found = tracker.ObjectTracker(triplet.model, rig).detect([view.image for view in triplet.views])
    if found.object_pose is None:
        return triplet
    return Triplet(triplet.model, triplet.views, found.object_pose.position, found.object_pose.rotation)


def _noise(triplets: Sequence[Triplet], level: float) -> float:
    curves = [noise_curve(view.image, 1) for triplet in triplets for view in triplet.views]
    near = [float(np.interp(level, curve[:, 0], curve[:, 1])) for curve in curves if len(curve) > 1]
    return float(np.median(near))


def _spectrum(triplets: Sequence[Triplet]) -> float:
    """Return the noise power of green at its highest frequencies relative to middle ones."""
    powers = [noise_spectrum(view.image, 1) for triplet in triplets for view in triplet.views]
    return float(np.median([power[-1] / power[len(power) // 2] for power in powers]))


def _of(inner: bool | None, value: Callable[[EdgeProfile], float]) -> Callable[[Sequence[Triplet]], float]:
    def median(triplets: Sequence[Triplet]) -> float:
        own = [p for triplet in triplets for p in edge_profiles(triplet) if inner in (None, p.inner)]
        return float(np.median([value(profile) for profile in own])) if own else np.nan

    return median


MEASURES: dict[str, Callable[[Sequence[Triplet]], float]] = {
    "inner edges: beyond both sides [levels]": _of(True, lambda p: max(p.over, p.under)),
    "outer edges: beyond both sides [levels]": _of(False, lambda p: max(p.over, p.under)),
    "inner edges: width [px]": _of(True, lambda p: p.width),
    "outer edges: width [px]": _of(False, lambda p: p.width),
    "edges: stray of profiles from their line [px]": _of(None, lambda p: p.stray),
    "edges: line off the fitted pose's [px]": _of(None, lambda p: abs(p.offset)),
    **{f"noise of green at level {level:g}": lambda t, level=level: _noise(t, level) for level in _LEVELS},
    "noise of green: highest over middle frequencies": _spectrum,
}


@click.command()
@click.argument("real", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="Sheet to write.")
@click.option("--effects", default="world", help="Of the rendered pictures.")
@click.option("--draws", default=4, help="Rendered triplets for each recorded one.")
@click.option("--seed", default=5150, help="Of the draws.")
def main(real: Path, output: Path, effects: str, draws: int, seed: int) -> None:
    """Write the sheet and print the table."""
    records = {name: recorded(real, name) for name in POSED}
    made = {name: list(map(fitted, redrawn(records[name], effects, draws, seed))) for name in POSED}
    cv2.imwrite(str(output), sheet([(records[name], made[name][0]) for name in POSED]))
    click.echo("| median | " + " | ".join(f"{kind}: recorded | rendered | ratio" for kind in KINDS) + " |")
    click.echo("|---" * (1 + 3 * len(KINDS)) + "|")
    for title, measure in MEASURES.items():
        cells = []
        for names in KINDS.values():
            there = measure([records[name] for name in names])
            here = measure([triplet for name in names for triplet in made[name]])
            cells += [f"{there:.2f}", f"{here:.2f}", f"{here / there:.2f}"]
        click.echo(f"| {title} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
