"""Draw the figures of docs/how-it-works.md: one for each stage of a detection, from the still of the demo.

    python scripts/draw_how_it_works.py [--output FOLDER] [--quick]

The scene is the one that `examples/still.py` writes to the folder `demo`. The figures show the values with
which the tracker itself works; only the curves in `strips.jpg` are fitted here.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.special import ndtr

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.stills import scene_with_fingers, take
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.geometry import cuboid, so3
from tracker.objects.labels import COLOR_NAMES, DISPLAY_COLORS_BGR
from tracker.objects.model import CuboidModel
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Start
from tracker.pose.hypotheses import EVERYWHERE, Round
from tracker.pose.rotations import rank_rotations
from tracker.pose.solve import residual
from tracker.pose.views import Sight
from tracker.pose.votes import DOUBT, gather, view_points, vote

SEED = 6
"""Seed of the scene: that of examples/still.py."""

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "how-it-works"

TINTS = np.array([[0.94, 0.94, 0.94], *(DISPLAY_COLORS_BGR[1:, ::-1] / 255 * 0.8 + 0.1)])
"""(7, 3) RGB colours of the labels in figures."""

LONGER = 12.0
"""Factor by which offsets are enlarged in figures."""

HIT, OFF, MARK = "#1b7f3b", "#d1341f", "#ff3d14"

parser = argparse.ArgumentParser(description="Draw the pictures of docs/how-it-works.md.")
parser.add_argument(
    "--output", type=Path, default=FOLDER, help="folder to write to (default: docs/how-it-works)"
)
parser.add_argument("--quick", action="store_true", help="small pictures, to see whether it works")


class Scene(NamedTuple):
    """The scene of the figures, with the tracker's intermediate values."""

    model: CuboidModel
    rig: CameraRig
    images: Sequence[Array]
    position: FloatArray
    """(3,) true position [m]."""
    rotation: FloatArray
    """(3, 3) true world_from_object."""
    estimator: PoseEstimator
    sight: Sight


def make_scene() -> Scene:
    """Render the still, and compute its label maps."""
    model, rig = tracker.load_object("cube_v2"), CameraRig(default_cameras())
    rng = np.random.default_rng(SEED)
    still = take(scene_with_fingers(model, rng), rig.cameras, Sensor.realistic(), rng, shadows=True)
    estimator = tracker.ObjectTracker(model, rig)._estimator
    sight = estimator.reader(still.images)
    return Scene(model, rig, still.images, still.position, still.rotation, estimator, sight)


def draw_labels(scene: Scene) -> Figure:
    """Draw the images above, label maps below."""
    figure = Figure(figsize=(9, 6.3), layout="constrained")
    axes = figure.subplots(2, 3)
    for c, camera in enumerate(scene.rig):
        axes[0, c].imshow(scene.images[c][..., ::-1])
        labels = scene.sight.labels[c]
        axes[1, c].imshow(TINTS[labels], interpolation="nearest")
        axes[0, c].set_title(f"{camera.name}: image, {camera.width} × {camera.height}")
        axes[1, c].set_title(f"labels, {labels.shape[1]} × {labels.shape[0]}")
    for label in range(1, len(COLOR_NAMES)):
        axes[1, 0].scatter([], [], marker="s", s=60, color=TINTS[label], label=COLOR_NAMES[label])
    figure.legend(loc="outside lower center", ncols=6, frameon=False)
    _bare(axes)
    return figure


def found_positions(scene: Scene) -> list[FloatArray]:
    """Return the candidate positions (3,) [m], best vote first."""
    positions, sight = scene.estimator.search.positions, scene.sight
    views = positions.views(sight.labels, sight.pictures)
    return list(positions(views, sight.labels, sight.pictures, EVERYWHERE.places))


def draw_votes(scene: Scene, quick: bool) -> Figure:
    """Draw the votes from above, and the squares in which they are counted."""
    search, sight, found = scene.estimator.search.positions, scene.sight, found_positions(scene)
    side, heights = (
        np.linspace(-0.235, 0.235, 24 if quick else 95),
        np.linspace(0.01, 0.185, 4 if quick else 15),
    )
    y, x, z = np.meshgrid(side, side, heights, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    boxes, votes = search.boxes_at(points), np.empty(len(points), np.float32)
    views = np.empty(boxes.shape, np.float32)
    view_points(sight.labels, search.lenses, sight.pictures, boxes, views)
    vote(views, sight.pictures, votes)
    level = votes.reshape(x.shape).max(axis=2)
    level[np.hypot(x, y)[..., 0] >= scene.rig.arena.radius] = np.nan
    figure = Figure(figsize=(10.5, 4.9), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(2.1, 1, 1))
    axis = figure.add_subplot(grid[:, 0])
    shown = axis.imshow(level, extent=(-235, 235, -235, 235), origin="lower", cmap="viridis", vmin=0)
    figure.colorbar(shown, ax=axis, label="vote $V$ at the best height", shrink=0.85)
    axis.plot(*(1e3 * scene.position[:2]), "o", mfc="none", mec="w", ms=19, mew=1.8, label="true centre")
    for rank, position in enumerate(found, start=1):
        axis.plot(
            *(1e3 * position[:2]), "x", color=MARK, ms=8, mew=2.5, label="positions" if rank == 1 else None
        )
        axis.annotate(
            str(rank), 1e3 * position[:2], (9, -4), textcoords="offset points", color=MARK, weight="bold"
        )
    axis.set(xlabel="x [mm]", ylabel="y [mm]", title="votes over the arena, seen from above")
    axis.legend(loc="lower right", fontsize=9)
    for c, camera in enumerate(scene.rig):
        part = figure.add_subplot(grid[c // 2, 1 + c % 2])
        part.imshow(TINTS[sight.labels[c]], interpolation="nearest")
        for rank, position in enumerate(found[:2], start=1):
            _draw_squares(part, search.lenses[c], position, search.radius, str(rank))
        part.set(title=camera.name, xticks=[], yticks=[])
    text = figure.add_subplot(grid[1, 2])
    text.axis("off")
    text.text(
        0, 0.5,
        f"Full square: a radius ({1e3 * search.radius:.0f} mm)\naround the point; dashed: 0.6 of it.\n\n"
        "V: pixels of each colour in them\nover the number expected of the\nobject, a third at most for\n"
        "each colour and square; summed over\nthe cameras that see the point,\n"
        f"over 1 + their number / {DOUBT:g}.",
        va="center", fontsize=10,
    )  # fmt: skip
    return figure


def _draw_squares(axis: Any, lens: Any, position: FloatArray, radius: float, name: str) -> None:
    """Draw the squares around a position (3,) [m] in a label map, if they are in it."""
    x, y, z = lens["rotation"] @ position + lens["translation"]
    u, v = lens["focal"] * (x / z, y / z) + lens["center"]
    reach = radius * float(lens["focal"][0]) / z
    if not (0 <= u < lens["width"] and 0 <= v < lens["height"]):
        return
    for share, style in ((1.0, "-"), (0.6, "--")):
        corner = share * reach * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
        axis.plot(u + corner[:, 0], v + corner[:, 1], "k", ls=style, lw=1.2)
    axis.plot(u, v, "x", color=MARK, ms=6, mew=2)
    # Label above the square if there is no room below it.
    below, height = v + reach + 1, lens["height"]
    place, side = (below, "top") if below < 0.9 * height else (v - reach - 1, "bottom")
    axis.text(max(u - reach, 0), place, name, color=MARK, weight="bold", va=side, ha="left")
    axis.set(xlim=(-0.5, lens["width"] - 0.5), ylim=(lens["height"] - 0.5, -0.5))


def draw_rotations(scene: Scene) -> Figure:
    """Draw rotations of the even grid by rank, at the candidate position on the object, in all label maps."""
    estimator, sight = scene.estimator, scene.sight
    position = min(found_positions(scene), key=lambda at: float(np.linalg.norm(at - scene.position)))
    grid, single, _ = estimator.search.grid
    count, stats, costs = len(grid), np.empty((len(sight.labels), 7, 3)), np.empty(len(grid), np.float32)
    radius = 1.1 * estimator.box.radius
    gather(estimator.search.lenses, sight.labels, sight.pictures, position, radius, stats)
    rank_rotations(
        estimator.search.lenses, sight.pictures, estimator.search.faces, position, stats, single, costs
    )
    rotations, costs = grid[np.argsort(costs)], np.sort(costs)
    ranks = (1, 2, 3, 10, 100, count - 1)
    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.subplots(3, len(ranks))
    for column, rank in enumerate(ranks):
        rotation = rotations[rank - 1]
        off = np.degrees(so3.angle_between(rotation, scene.rotation))
        axes[0, column].set_title(
            f"rank {rank} of {count}\ncost {costs[rank - 1]:.0f}\n{off:.0f}° from the truth"
        )
        for c, axis in enumerate(axes[:, column]):
            axis.imshow(TINTS[sight.labels[c]], interpolation="nearest")
            factor, outline = estimator.reader.factors[c], _outline(scene, c, rotation, position)
            for face, pixels in outline:
                small = (pixels + 0.5) / factor - 0.5
                tint = TINTS[scene.model.face_labels[face]]
                axis.fill(*small.T, fill=False, ec="k", lw=2.2)
                middle = small.mean(axis=0)
                axis.fill(*(middle + 0.55 * (small - middle)).T, fc=tint, ec="k", lw=0.8)
            middle = np.concatenate([pixels for _, pixels in outline]).mean(axis=0) / factor
            axis.set(xlim=middle[0] + np.array([-24, 24]), ylim=middle[1] + np.array([24, -24]))
    for axis, camera in zip(axes[:, 0], scene.rig, strict=True):
        axis.set_ylabel(camera.name)
    _bare(axes)
    return figure


class Edges(NamedTuple):
    """The strips of all cameras at one pose."""

    strips: Array
    """(C, S) of STRIP."""
    found: Array
    """(C, S) of OFFSET."""
    counts: Array
    """(C,) number of strips of each camera."""
    reaches: Array
    """(C,) half widths of the strips [px]."""
    distance: FloatArray
    """(C, P) signed distances of the strips' pixels from the edge [px]."""
    values: FloatArray
    """(C, 3, P) colours of these pixels."""
    blurs: FloatArray
    """(C,) standard deviations of the images' blurred steps [px]."""
    start: Start
    """Exponent of the response, and rim."""

    def left(self, c: int) -> tuple[Array, FloatArray]:
        """Return the usable strips of camera c, and their residuals [px]."""
        usable = np.flatnonzero(self.found[c, : self.counts[c]]["usable"])
        exponent, rim = self.start.exponent, self.start.rim
        offsets = [residual(self.strips[c, s], self.found[c, s], np.zeros(6), exponent, rim) for s in usable]
        return usable, np.array(offsets)


def edges_at(scene: Scene, rotation: FloatArray, position: FloatArray, start: Start) -> Edges:
    """Place strips at a pose, and measure their offsets."""
    refiner, pictures = scene.estimator.refiner, scene.sight.pictures
    _, cameras, work = refiner.edges(pictures, rotation, position, start)
    parts = work.strips, work.found, cameras["strips"], cameras["reach"], work.distance, work.values
    return Edges(*(part.copy() for part in parts), cameras["blur"].copy(), start)


def before_and_after(scene: Scene) -> tuple[Edges, Edges]:
    """Return strips at the best hypothesis after alignment on the label maps, and at its refined pose."""
    estimator, sight = scene.estimator, scene.sight
    best = estimator.search.rounds(sight)(Round(places=1, rotations=2))[0]
    fit = estimator.refiner(sight, best.rotation, best.position)
    return edges_at(scene, best.rotation, best.position, fit.end), edges_at(
        scene, fit.rotation, fit.position, fit.end
    )


def draw_strips(scene: Scene, before: Edges) -> Figure:
    """Draw one camera's strips with their offsets, and the pixels of one strip with the model's curves."""
    c = 0
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
    _crop(left, scene, c)
    strips = before.strips[c, : before.counts[c]]
    usable, _ = before.left(c)
    for s, strip in enumerate(strips):
        along = np.array([-strip["normal"][1], strip["normal"][0]]) * strip["length"] / 2
        out = strip["normal"] * before.reaches[c]
        corners = strip["pixel"] + np.array([along + out, along - out, -along - out, out - along])
        color = "w" if s in usable else OFF
        left.fill(*corners.T, fill=False, ec=color, lw=0.7, alpha=0.9, ls="-" if s in usable else ":")
    for s, offset in zip(usable, before.found[c]["offset"][usable], strict=True):
        ends = strips[s]["pixel"] + np.outer([0, LONGER / 3 * offset], strips[s]["normal"])
        left.plot(*ends.T, color="#ffe600", lw=1.8, solid_capstyle="round")
    chosen = _clearest(before, c, usable)
    left.plot(*strips[chosen]["pixel"], "o", mfc="none", mec="#ffe600", ms=13, mew=2)
    left.set_title(
        f"{scene.rig[c].name}: strips at the hypothesis\nwhite: measured; dotted red: colours of no face;\n"
        f"yellow: offset to the edge, {LONGER / 3:.0f} times as long",
        fontsize=10,
    )
    _draw_profile(right, before, c, chosen)
    return figure


def _clearest(edges: Edges, c: int, usable: Array) -> int:
    """Return the strip on the object's outline with the largest offset in standard deviations."""
    found, strips = edges.found[c][usable], edges.strips[c][usable]
    clear = np.abs(found["offset"]) / np.sqrt(found["variance"])
    alone = (strips["outside"] == 0) & (strips["reach_in"] > 2 * edges.reaches[c])
    return int(usable[np.argmax(np.where(alone, clear, 0.0))])


def _draw_profile(axis: Any, edges: Edges, c: int, s: int) -> None:
    """Draw the pixels of a strip and the curves of equation (8)."""
    strip, blur = edges.strips[c, s], edges.blurs[c]
    offset, reach = float(edges.found[c, s]["offset"]), float(edges.reaches[c])
    fine = np.linspace(-reach, reach, 200)

    def columns(d: FloatArray) -> FloatArray:
        step = ndtr((d - offset) / blur)
        return np.stack([1 - step, step], axis=1)

    for k, (name, color) in enumerate(zip("BGR", ("#2457c5", "#1b8a3a", "#c8281e"), strict=True)):
        # In a mosaic each channel has its own pixels.
        part = k if strip["count"][1] > 0 else 0
        pixels = slice(strip["first"][part], strip["first"][part] + strip["count"][part])
        at, values = edges.distance[c, pixels], edges.values[c, k, pixels]
        colors = np.linalg.lstsq(columns(at), values, rcond=None)[0]
        axis.plot(at, values, "o", color=color, ms=4.5, alpha=0.75)
        axis.plot(
            fine,
            columns(fine) @ colors,
            color=color,
            lw=2,
            label=f"{name}: {colors[0]:.0f} → {colors[1]:.0f}",
        )
    axis.axvline(0, color="k", ls="--", lw=1)
    axis.axvline(offset, color="#b79b00", lw=2)
    bottom, top = axis.get_ylim()
    axis.set_ylim(bottom, top + 0.12 * (top - bottom))
    top = axis.get_ylim()[1]
    axis.annotate("pose", (0, top), (5, -14), textcoords="offset points", fontsize=9)
    axis.annotate(
        f"edge: {offset:+.2f} ± {np.sqrt(edges.found[c, s]['variance']):.2f} px",
        (max(offset, 0.0), top), (5, -28),
        textcoords="offset points", fontsize=9, color="#8a7400",
    )  # fmt: skip
    axis.legend(title="inside → outside", loc="best", fontsize=9)
    axis.set(
        xlabel="signed distance $d$ from the edge as the pose puts it [px], out of the face",
        ylabel="pixel value", title="the circled strip: its pixels, and the blurred step",
    )  # fmt: skip


def draw_residuals(scene: Scene, before: Edges, after: Edges) -> Figure:
    """Draw the residuals before and after the refinement."""
    c = 0
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.25))
    for axis, edges, name in zip(axes, (before, after), ("before", "after"), strict=False):
        _crop(axis, scene, c)
        usable, left = edges.left(c)
        at, normal = edges.strips[c]["pixel"][usable], edges.strips[c]["normal"][usable]
        ends = np.stack([at, at + LONGER * left[:, None] * normal], axis=1)
        axis.add_collection(LineCollection(list(ends), colors="k", linewidths=3.2))
        axis.add_collection(LineCollection(list(ends), colors="#ffe600", linewidths=1.7))
        axis.plot(*at.T, ".", color="k", ms=3)
        axis.set_title(f"{name} the refinement\nresiduals {LONGER:.0f} times as long", fontsize=10)
    bins = np.linspace(-1.0, 1.0, 41)
    for edges, name, color in ((before, "before", OFF), (after, "after", HIT)):
        left = np.concatenate([edges.left(k)[1] for k in range(len(scene.rig))])
        median = float(np.median(np.abs(left)))
        axes[2].hist(np.clip(left, -1.0, 1.0), bins, color=color, alpha=0.65,
                     label=f"{name}: median size {median:.3f} px")  # fmt: skip
    axes[2].set(xlabel="residual $r$ [px]; beyond ±1: at ±1", ylabel="strips")
    axes[2].set_title("what is left to explain, of all cameras")
    axes[2].set_ylim(top=1.3 * axes[2].get_ylim()[1])
    axes[2].legend(fontsize=9, loc="upper left")
    return figure


def _outline(
    scene: Scene, c: int, rotation: FloatArray, position: FloatArray
) -> list[tuple[int, FloatArray]]:
    """Return the faces that camera c sees at a pose, and their corners (4, 2) [px]."""
    camera = scene.rig[c]
    seen = cuboid.visible_faces(scene.model.size, rotation.T @ (camera.position - position))
    pixels = camera.project(position + cuboid.corners(scene.model.size) @ rotation.T)
    return [(int(face), pixels[cuboid.FACE_CORNERS[face]]) for face in np.flatnonzero(seen)]


def _crop(axis: Any, scene: Scene, c: int, rim: float = 8.0) -> None:
    """Show the region of camera c's image that contains the object."""
    pixels = np.concatenate([points for _, points in _outline(scene, c, scene.rotation, scene.position)])
    low, high = pixels.min(axis=0) - rim, pixels.max(axis=0) + rim
    axis.imshow(scene.images[c][..., ::-1], interpolation="nearest")
    axis.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), xticks=[], yticks=[])


def _bare(axes: Any) -> None:
    for axis in np.ravel(axes):
        axis.set(xticks=[], yticks=[])


def main(folder: Path, quick: bool) -> None:
    """Draw and save all figures."""
    mpl.rcParams.update({"font.size": 10, "axes.titlesize": 10})
    scene = make_scene()
    before, after = before_and_after(scene)
    figures = {
        "labels.jpg": draw_labels(scene),
        "votes.png": draw_votes(scene, quick),
        "rotations.jpg": draw_rotations(scene),
        "strips.jpg": draw_strips(scene, before),
        "residuals.jpg": draw_residuals(scene, before, after),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=40 if quick else 90, pil_kwargs={"quality": 82, "optimize": True})
        print(folder / name)


if __name__ == "__main__":
    arguments = parser.parse_args()
    main(arguments.output, arguments.quick)
