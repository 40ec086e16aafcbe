"""The model of the tracker's errors: measured on films with ground truth, fitted, written and compared.

A film is played with many calibrations, each an episode. In every second episode, grey covers in front of the
object come and go, so that all visible fractions occur.
"""

import dataclasses
import time
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

import tracker
from benchmarks.data.disturbances import shifted
from benchmarks.data.films import RATE, FilmFrame, FilmStore
from benchmarks.data.plan import Plan
from benchmarks.data.scenes import rig
from benchmarks.measure.timing import one_thread
from benchmarks.score.errors import placed, projected
from benchmarks.score.noise import FITTED, Values, agreement, fit, simulated, to_toml
from synthetic.camera.miscalibration import stated
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.files import write_whole
from tracker.geometry import so3
from tracker.geometry.cuboid import corners
from tracker.noise import NoiseModel

FILMS, LENGTH, CALIBRATIONS = 48, 60, 12
"""Number of films per object, frames per film, and calibrations per film."""

REFINED = 0.16e-3, np.radians(0.02)
"""Standard deviation of refined cameras [m, rad]: benchmarks/development.md, "Cameras, refined"."""

IMAGES = 0.036
"""Delay from the exposure to the tracker [s]: the 90 ms assumed by the platform's simulation, less the time
that its tracker takes."""

COVERED = 1.0
"""Mean duration of a period with or without covers [s]."""


def measured(name: str, plan: Plan, check: int, output: Path, *, refined: bool) -> str:
    """Fit a model to the plan's films, write it, and compare it with films of the seed `check`.

    Returns:
        The table of the comparison, with the processor time of a step.
    """
    episodes, films, spent = measure_noise(name, plan, refined=refined)
    start: Values = {
        group: {key: pair[part] for key, pair in FITTED.items()}
        for part, group in enumerate(("position", "rotation"))
    }
    logs = np.log(spent)
    delay = {"images": IMAGES, "pose": float(np.exp(np.median(logs))), "spread": float(logs.std())}
    found = fit(episodes, films, start | {"delay": delay})
    # From recordings' means: other work of the computer changes the median by more than chance.
    ends = np.quantile(np.reshape(logs, (-1, LENGTH)).mean(axis=1), [0.025, 0.975])
    found["delay"] = {
        "images": (IMAGES, []),
        "pose": (delay["pose"], sorted([*np.exp(ends), delay["pose"]])[::2]),
        "spread": (delay["spread"], []),
    }
    cameras = "off by 0.16 mm and 0.02° only, as a refinement leaves them" if refined else "as calibrated"
    about = (
        f"This tracker: poses that update measures on rendered films of {name} with all effects and covers, "
        f"three cameras of 270 x 270 at 10 Hz, cameras {cameras}; written by python -m benchmarks noise"
    )
    write_whole(output, to_toml(about, found))
    fresh = np.stack(measure_noise(name, dataclasses.replace(plan, seed=check), refined=refined)[0])
    model = NoiseModel.load(output)
    values = {
        group: {key: number.value for key, number in numbers.items()}
        for group, numbers in model.numbers.items()
    }
    modelled = simulated(values, list(fresh), seed=5)
    write_plot(fresh, modelled, output.with_suffix(".png"))
    lines = [f"{'':34s} measured   model  differ by"]
    for what, one, other in agreement(fresh, modelled):
        lines.append(f"{what:34s} {one:8.3f} {other:7.3f} {100 * (other / one - 1):8.1f} %")
    return "\n".join([*lines, f"a step of 4096 environments: {step_time(model):.2f} ms of processor time"])


def measure_noise(
    object_name: str, plan: Plan, *, refined: bool = False
) -> tuple[list[Array], list[int], list[float]]:
    """Return episodes, the film number of each, and the processor time of all updates [s]."""
    store = FilmStore(object_name, "errors", LENGTH, plan)
    store.prepare(range(FILMS), vanishing=False)
    model = tracker.load_object(object_name)
    episodes, films, spent = [], [], []
    with one_thread():
        for film in range(FILMS):
            frames = list(store.frames(film, range(LENGTH)))
            true, given = frames[0].rigs(rig())
            for k in range(CALIBRATIONS):
                rng = np.random.default_rng([plan.seed, film, k])
                own = given if k == 0 else stated(true, rng)
                own = mended(true, own, rng) if refined else own
                shown = covered(frames, true, model.size, rng) if k % 2 else frames
                rows, seconds = played(tracker.ObjectTracker(model, own), shown)
                episodes.append(rows)
                films.append(film)
                spent += seconds
    return episodes, films, spent


def mended(true: CameraRig, given: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Draw the cameras that a refinement would yield."""
    cameras = []
    for camera, before in zip(true, given, strict=True):
        turn, shift = (size / np.sqrt(3.0) * rng.standard_normal(3) for size in REFINED[::-1])
        std = before.camera_from_world_std
        std = None if std is None else 0.3 * std
        cameras.append(dataclasses.replace(shifted(camera, turn, shift), camera_from_world_std=std))
    return dataclasses.replace(true, cameras=tuple(cameras))


def played(own: tracker.ObjectTracker, frames: Iterable[FilmFrame]) -> tuple[FloatArray, list[float]]:
    """Return an episode (T, 16) of the poses that `update` measures, and the processor time of each [s]."""
    rows, spent = [], []
    for frame in frames:
        assert frame.position is not None
        assert frame.rotation is not None
        start = time.process_time()
        pose = own.update(frame.images, frame.stamps).object_pose
        spent.append(time.process_time() - start)
        error = np.full(7, np.nan)
        if pose is not None:
            turn = so3.log(so3.matrix_from_quaternion(pose.orientation) @ frame.rotation.T)
            error = np.r_[pose.position - frame.position, turn, pose.confidence]
        true = frame.position, so3.quaternion_from_matrix(frame.rotation)
        rows.append(np.concatenate([[frame.timestamp, np.mean(frame.visible_fraction)], error, *true]))
    return np.array(rows), spent


def covered(
    frames: list[FilmFrame], true: CameraRig, size: FloatArray, rng: np.random.Generator
) -> list[FilmFrame]:
    """Return the film with covers that temporarily hide part of the object from each camera."""
    shares, at = np.zeros((len(frames), len(true))), 0
    while at < len(frames):
        at += max(1, round(RATE * rng.exponential(COVERED)))
        end = at + max(1, round(RATE * rng.exponential(COVERED)))
        own = np.sqrt(rng.random()) + 0.15 * rng.standard_normal(len(true))
        shares[at:end] = np.clip(own, 0.0, 1.0)
        at = end
    angles, grey = rng.uniform(0.0, 2.0 * np.pi, len(true)), int(rng.integers(30, 160))
    result = []
    for frame, share in zip(frames, shares, strict=True):
        ends = placed(corners(size), frame.position, frame.rotation)  # type: ignore[arg-type]
        images = tuple(
            _with_cover(image, projected(camera, ends), float(part), float(angle), grey)
            for image, camera, part, angle in zip(frame.images, true, share, angles, strict=True)
        )
        seen = frame.visible_fraction * (1.0 - share)
        result.append(dataclasses.replace(frame, images=images, visible_fraction=seen))
    return result


def _with_cover(image: Image, ends: FloatArray, share: float, angle: float, grey: int) -> Image:
    outline = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(outline, cv2.convexHull(np.round(ends).astype(np.int32)), (1,))
    if share <= 0.0 or not outline.any():
        return image
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    across = np.cos(angle) * x + np.sin(angle) * y
    center = ends.mean(axis=0)
    reach = 1.2 * np.linalg.norm(ends - center, axis=1).max()
    near = np.hypot(x - center[0], y - center[1]) < reach
    result = image.copy()
    result[near & (across <= np.quantile(across[outline > 0], share))] = grey
    return result


def step_time(model: NoiseModel, count: int = 4096) -> float:
    """Return the median processor time of one step of `count` environments [ms]."""
    rng = np.random.default_rng(0)
    state = model.start(rng, count)
    truth = rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), rng.uniform(0.3, 1.0, count)
    spent = []
    for _ in range(200):
        begin = time.process_time()
        state.step(*truth, 0.1)
        spent.append(time.process_time() - begin)
    return 1e3 * float(np.median(spent))


def write_plot(measured_: Array, modelled: Array, target: Path) -> None:
    """Plot the cumulative distributions of error sizes in films and in the model."""
    figure = Figure(figsize=(9, 3.2), dpi=100, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, columns, scale, unit in zip(
        axes, (slice(2, 5), slice(5, 8)), (1e3, 180 / np.pi), ("position [mm]", "rotation [°]"), strict=True
    ):
        for label, style, color, episodes in (
            ("films", "-", "#222222", measured_),
            ("model", "--", "#3366aa", modelled),
        ):
            size = scale * np.linalg.norm(episodes[..., columns], axis=2).ravel()
            size = np.sort(size[np.isfinite(size)])
            shares = np.arange(1, len(size) + 1) / len(size)
            axis.plot(size, 100 * shares, style, color=color, label=label)
        axis.set(xlabel=f"error of {unit}", xscale="log", xlim=(0.05, 10))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("errors below [%]")
    axes[0].legend(frameon=False)
    figure.savefig(target)
