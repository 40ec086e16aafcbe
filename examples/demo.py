"""Simulate the platform, film it, find the object in every frame, and compare with the truth.

    python examples/demo.py [--object NAME] [--frames N] [--seed S] [--output FOLDER]

Writes the first frame's images and their calibration, overlay.png, overlay.mp4 and errors.png to the
folder.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import tracker
from synthetic.camera.rigs import sized, standard_rig
from synthetic.frames import Frame, frames
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.viz import overlay, write_film, write_image

RATE = 10.0
"""Frames per second of the platform's cameras."""

parser = argparse.ArgumentParser(
    description="Simulate the platform, film it, find the object in every frame."
)
parser.add_argument("--object", default="cube_v2", help="name of the object (default: %(default)s)")
parser.add_argument("--frames", type=int, default=60, help="length of the film (default: %(default)s)")
parser.add_argument("--seed", type=int, default=3, help="seed of the film (default: %(default)s)")
parser.add_argument(
    "--output", type=Path, default=Path("demo"), help="new folder to write to (default: %(default)s)"
)


def main(name: str, count: int, seed: int, folder: Path) -> None:
    """Simulate, detect, print and write."""
    model, rig = tracker.load_object(name), sized(standard_rig(), 270)
    detector = tracker.ObjectTracker(model, rig)
    rows: list[list[float]] = []
    stills: list[Image] = []

    def film() -> Iterator[Image]:
        for frame in frames(name, count, seed, rig=rig, sequence=True, kind="mixed"):
            observation = detector.detect(frame.images)
            picture = overlay(frame.images, rig, model, observation, title=f"{frame.timestamp:.1f} s")
            if frame.index == 0:
                save_first(folder, rig, frame.images)
            rows.append(
                [frame.timestamp, float(np.mean(frame.visible_fraction)), *errors(observation, frame)]
            )
            stills.append(picture)
            if sys.stdout.isatty():
                print(f"\rframe {frame.index + 1} of {count}", end="", flush=True)
            yield picture

    write_film(folder / "overlay.mp4", film(), RATE)
    print()
    result = np.array(rows)
    write_image(folder / "overlay.png", stills[int(np.argmin(np.abs(result[:, 1] - 0.8)))])
    plot(result, folder / "errors.png")
    report(result)
    print(f"pictures: {folder / 'overlay.png'}, {folder / 'overlay.mp4'}, {folder / 'errors.png'}")


def save_first(folder: Path, rig: tracker.CameraRig, images: Sequence[Image]) -> None:
    """The images of one frame and the calibration, as a platform would leave them."""
    rig.save(folder)
    for camera, image in zip(rig.names, images, strict=True):
        write_image(folder / f"{camera}.png", image)


def errors(observation: tracker.Observation, frame: Frame) -> tuple[float, float, float]:
    """Position error [mm], rotation error [deg] and confidence; NaN where there is no pose or no object."""
    pose = observation.object_pose
    if pose is None or not frame.objects:
        return np.nan, np.nan, 0.0 if pose is None else pose.confidence
    truth = frame.objects[0]
    distance = 1e3 * np.linalg.norm(pose.position - truth.position)
    return (
        float(distance),
        float(np.degrees(so3.angle_between(pose.rotation, truth.rotation))),
        pose.confidence,
    )


def report(result: FloatArray) -> None:
    """Print the errors of all frames as a table."""
    found = np.isfinite(result[:, 2])
    right = (result[found, 2] < 5) & (result[found, 3] < 5)
    print(f"frames           {len(result)}, mean visible fraction {result[:, 1].mean():.2f}")
    print(f"no pose          {np.sum(~found)}")
    print(f"within 5 mm, 5°  {right.sum()}")
    print("error              median       p90       max")
    for label, column, unit in (("position", 2, "mm"), ("rotation", 3, "degrees")):
        values = result[found, column]
        if values.size:
            figures = (np.median(values), np.quantile(values, 0.9), values.max())
            print(f"  {label:12s}", *(f"{value:9.2f}" for value in figures), unit)


def plot(result: FloatArray, path: Path) -> None:
    """Errors, confidence and visible fraction over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator

    figure, axes = plt.subplots(3, 1, figsize=(9, 6), sharex=True, layout="constrained")
    time = result[:, 0]
    for axis, column, label in ((axes[0], 2, "position error [mm]"), (axes[1], 3, "rotation error [°]")):
        axis.semilogy(time, result[:, column], ".-", color="#3366aa", linewidth=1)
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("")
        axis.set_ylabel(label)
    axes[2].plot(time, result[:, 1], color="#888888", label="visible fraction")
    axes[2].plot(time, result[:, 4], color="#cc5533", label="confidence")
    axes[2].set_ylim(0, 1.05)
    axes[2].set_xlabel("time [s]")
    axes[2].legend(loc="lower left", frameon=False)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    arguments = parser.parse_args()
    if arguments.output.exists() and any(arguments.output.iterdir()):
        parser.error(f"--output {arguments.output}: in use, expected a new or an empty folder")
    arguments.output.mkdir(parents=True, exist_ok=True)
    try:
        main(arguments.object, arguments.frames, arguments.seed, arguments.output)
    except tracker.TrackerError as error:
        parser.error(str(error))
