"""Measure the appearance of the object's edges in recorded triplets and in renderings of the same poses.

    python scripts/measure_edges.py REAL_FOLDER [--effects none|world|NAMES] [--draws N]

Across every edge with both sides in view, intensity profiles are aligned on the edge line that they
themselves show, and averaged. Measured for each edge: how far the brightness exceeds the range of both sides
(a glint, a dark seam), the width of the step, and the scatter of single profiles about the line.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import click
import cv2
import numpy as np
from restage import POSED, Triplet, View, recorded, redrawn

from tracker.conventions import Array, FloatArray
from tracker.geometry.cuboid import EDGES, FACE_NORMALS, corners

STEP = 0.25
"""Spacing of the samples of a profile [px]."""

REACH, SIDE, MIDDLE = 8.0, (3.5, 6.0), 2.0
"""Half the length of a profile, the range in which its sides are assumed even, and the largest distance from
the edge at which its rim may show [px]."""

OFFSETS = np.arange(-REACH, REACH + STEP / 2, STEP)
"""Places of the samples of a profile across the edge [px]."""

SEARCH = 3.0
"""Largest distance between the projected edge and the image's [px]."""

LEAST = 12
"""Smallest number of profiles of an edge; half as many for edges on which the object stands."""

STANDING = 0.003
"""Largest height above the object's lowest corner of the ends of an edge on which it stands [m]."""


@dataclasses.dataclass(frozen=True, eq=False)
class EdgeProfile:
    """The mean profile across one edge in one image."""

    inner: bool
    """Whether it is between two visible faces; otherwise between a face and the background."""
    values: FloatArray
    """(N, 3) BGR levels, from the visible face (of inner edges the first one) to the other side."""
    sides: FloatArray
    """(2, 3) BGR levels of both sides."""
    stray: float
    """Standard deviation of single profiles from the line [px]."""
    offset: float
    """Offset of the line's middle from the projected edge [px]; positive outwards for outer edges."""
    lower: bool = False
    """Whether it is an outer edge on which the object stands, by the pose."""
    px_per_mm: float = np.nan
    """Pixels per millimetre at the edge's middle."""

    @property
    def over(self) -> float:
        """Excess of the rim's brightness over both sides [levels]."""
        return float(max(self._rim().max() - self.sides.mean(axis=1).max(), 0.0))

    @property
    def under(self) -> float:
        """Deficit of the rim's brightness below both sides [levels]."""
        return float(max(self.sides.mean(axis=1).min() - self._rim().min(), 0.0))

    @property
    def width(self) -> float:
        """Width of the step from 10 to 90 % [px]."""
        step = self.sides[1] - self.sides[0]
        share = (self.values - self.sides[0]) @ step / (step @ step)
        low, high = (OFFSETS[np.argmax(share > level)] for level in (0.1, 0.9))
        return float(high - low)

    def _rim(self) -> FloatArray:
        result: FloatArray = self.values[np.abs(OFFSETS) <= MIDDLE].mean(axis=1)
        return result


def edge_profiles(triplet: Triplet) -> Iterator[EdgeProfile]:
    """Yield profiles of all edges in all images that show enough of them."""
    size = triplet.model.size
    points = corners(size) @ triplet.rotation.T + triplet.position
    centers = (FACE_NORMALS * (size / 2)) @ triplet.rotation.T + triplet.position
    normals = FACE_NORMALS @ triplet.rotation.T
    for view in triplet.views:
        towards = ((view.camera.position - centers) * normals).sum(axis=1) > 0
        for a, b, *faces in EDGES:
            seen = [face for face in faces if towards[face]]
            if not seen:
                continue
            share = np.linspace(0.08, 0.92, 120)[:, None]
            line = view.camera.project(points[a] + share * (points[b] - points[a]))
            other = next(face for face in faces if face != seen[0])
            labels = [int(triplet.model.face_labels[face]) for face in (seen[0], other)]
            middle = view.camera.project(centers[seen[:1]])[0]
            lower = len(seen) == 1 and np.ptp([*points[[a, b], 2], points[:, 2].min()]) < STANDING
            labels[1] *= len(seen) == 2
            profile = _profile(view, line, middle, labels, LEAST // 2 if lower else LEAST)
            if profile is not None:
                away = np.linalg.norm(view.camera.position - points[[a, b]].mean(axis=0))
                scale = 1e-3 * float(view.camera.matrix[0, 0] / away)
                yield dataclasses.replace(profile, lower=bool(lower), px_per_mm=scale)


def _profile(
    view: View, line: FloatArray, middle: FloatArray, labels: Sequence[int], least: int
) -> EdgeProfile | None:
    """Return the profile between two labels; None if fewer than `least` single profiles show it."""
    first, second = labels
    tangent = line[-1] - line[0]
    length = float(np.linalg.norm(tangent))
    normal = np.array([-tangent[1], tangent[0]]) / length
    if normal @ (middle - line.mean(axis=0)) > 0:
        normal = -normal
    line = line[:: max(1, int(len(line) / length))]
    # The sides are wide enough for a face of 8 px, in images of half the size.
    scale = min(1.0, view.image.shape[0] / 540 + 0.25)
    sides = [scale * (SIDE[0] + SIDE[1]) / 2 * sign for sign in (-1, 1)]
    at = [_sampled(view.labels, line, normal, np.array([side])) for side in sides]
    kept = (at[0][:, 0] == first) & (at[1][:, 0] == second)
    if kept.sum() < least:
        return None
    line = line[kept]
    values = _sampled(view.image, line, normal, OFFSETS).astype(np.float64)
    distance = np.abs(OFFSETS)
    even = (distance >= scale * SIDE[0]) & (distance <= scale * SIDE[1])
    before, after = even & (OFFSETS < 0), even & (OFFSETS > 0)
    levels = np.stack([np.median(values[:, part], axis=(0, 1)) for part in (before, after)])
    step = levels[1] - levels[0]
    if np.linalg.norm(step) < 15:
        return None
    share = (values - levels[0]) @ step / (step @ step)
    crossing = _crossings(share)
    good = np.isfinite(crossing)
    if good.sum() < least:
        return None
    along = np.linspace(-1, 1, len(line))
    for _ in range(3):
        fit = np.polyfit(along[good], crossing[good], 1)
        miss = crossing - np.polyval(fit, along)
        good = np.isfinite(crossing) & (np.abs(miss) < max(3 * np.nanstd(miss[good]), 0.3))
    line = (line + np.polyval(fit, along)[:, None] * normal)[good]
    values = _sampled(view.image, line, normal, OFFSETS).astype(np.float64)
    mean = values.mean(axis=0)
    levels = np.stack([mean[part].mean(axis=0) for part in (before, after)])
    return EdgeProfile(second > 0, mean, levels, float(np.std(miss[good])), float(np.polyval(fit, 0.0)))


def _crossings(share: Array) -> FloatArray:
    """Return, for each row of shares (N, K), the rise through 0.5 nearest to 0 within SEARCH; NaN: none."""
    result = np.full(len(share), np.nan)
    near = np.flatnonzero(np.abs(OFFSETS) <= SEARCH)
    for row, values in enumerate(share):
        rises = [k for k in near[:-1] if values[k] < 0.5 <= values[k + 1]]
        if rises:
            k = min(rises, key=lambda k: abs(OFFSETS[k]))
            result[row] = OFFSETS[k] + STEP * (0.5 - values[k]) / (values[k + 1] - values[k])
    return result


def _sampled(image: Array, line: FloatArray, normal: FloatArray, offsets: FloatArray) -> Array:
    """Return values (N, K, …) of an image at offsets (K,) [px] along `normal` (2,) from points (N, 2)."""
    places = (line[:, None] + offsets[:, None] * normal).astype(np.float32)
    how = cv2.INTER_NEAREST if image.ndim == 2 else cv2.INTER_LINEAR
    return np.asarray(cv2.remap(image, places[..., 0].copy(), places[..., 1].copy(), how))


def summary(profiles: Iterable[EdgeProfile]) -> list[str]:
    """Return the cells of the table's row."""
    cells: list[str] = []
    known = list(profiles)
    for inner in (True, False):
        own = [profile for profile in known if profile.inner == inner]
        over, under = np.array([[p.over, p.under] for p in own]).T
        beyond = np.maximum(over, under)
        cells += [
            f"{len(own)}",
            f"{100 * np.mean(beyond > 5):.0f}",
            f"{np.median(beyond):.1f}",
            f"{np.quantile(beyond, 0.9):.1f}",
            f"{np.median(over):.1f}/{np.median(under):.1f}",
            f"{np.median([p.width for p in own]):.2f}",
            f"{np.median([p.stray for p in own]):.2f}",
        ]
    return cells


def feet(profiles: Iterable[EdgeProfile]) -> list[str]:
    """Return cells about where faces end that are lighter than their background.

    They are for edges on which the object stands, and for its other outer edges.
    """
    outer = [p for p in profiles if not p.inner and p.sides[0].max() > p.sides[1].max()]
    cells: list[str] = []
    for lower in (True, False):
        offsets = np.array([[p.offset, p.offset / p.px_per_mm] for p in outer if p.lower == lower])
        cells.append(f"{len(offsets)}")
        cells += [f"{one.mean():.2f} ± {one.std():.2f}" for one in offsets.T]
    return cells


@click.command()
@click.argument("real", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--effects", default="none", help="Of the rendered pictures.")
@click.option("--draws", default=6, help="Rendered triplets for each recorded one.")
@click.option("--blur", type=float, help="Of the rendered pictures [px at 540], instead of what is drawn.")
@click.option("--seed", default=5150, help="Of the draws.")
def main(real: Path, effects: str, draws: int, seed: int, blur: float | None) -> None:
    """Print profiles of recorded and rendered edges."""
    head = ["edges", "beyond 5 [%]", "beyond", "90 %", "over/under", "width [px]", "stray [px]"]
    click.echo("| pictures | " + " | ".join([*head, *(f"outer {title}" for title in head)]) + " |")
    click.echo("|---" * (1 + 2 * len(head)) + "|")
    rows = []
    for name in POSED:
        record = recorded(real, name)
        drawn = redrawn(record, effects, draws, seed, blur=blur)
        made = [profile for triplet in drawn for profile in edge_profiles(triplet)]
        for title, profiles in (("recorded", list(edge_profiles(record))), (effects, made)):
            click.echo(f"| {name}, {title} | " + " | ".join(summary(profiles)) + " |")
            rows.append(f"| {name}, {title} | " + " | ".join(feet(profiles)) + " |")
    head = ["lower edges", "colours end off the contour [px]", "[mm]"]
    click.echo("\n| pictures | " + " | ".join([*head, *(f"other {title}" for title in head)]) + " |")
    click.echo("|---" * (1 + 2 * len(head)) + "|\n" + "\n".join(rows))


if __name__ == "__main__":
    main()
