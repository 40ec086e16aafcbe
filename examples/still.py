"""Render a still of a cube among three fingers, find it, and compare with the truth.

    python examples/still.py [--seed N] [--output FOLDER]

Writes the images, their calibration, and the picture overlay.png to the folder.
"""

import argparse
from pathlib import Path

import numpy as np

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.stills import Still, scene_with_fingers, take
from tracker.geometry import so3
from tracker.viz import overlay, write_image

parser = argparse.ArgumentParser(description="Render a cube among three fingers, and find it.")
parser.add_argument("--seed", type=int, default=6, help="seed of the scene (default: %(default)s)")
parser.add_argument(
    "--output", type=Path, default=Path("demo"), help="new folder to write to (default: %(default)s)"
)


def main(seed: int, folder: Path) -> None:
    """Render, detect, print and write."""
    model = tracker.load_object("cube_v2")
    rig = tracker.CameraRig(default_cameras())
    rng = np.random.default_rng(seed)
    still = take(scene_with_fingers(model, rng), rig.cameras, Sensor.realistic(), rng, shadows=True)
    observation = tracker.ObjectTracker(model, rig).detect(still.images)

    rig.save(folder)
    for name, image in zip(rig.names, still.images, strict=True):
        write_image(folder / f"{name}.png", image)
    write_image(folder / "overlay.png", overlay(still.images, rig, model, observation))

    if observation.object_pose is None:
        print(f"no pose: {observation.status}")
    else:
        report(observation.object_pose, still)
    print(f"picture: {folder / 'overlay.png'}")


def report(pose: tracker.PoseEstimate, truth: Still) -> None:
    """Print estimate, truth and error."""
    std = np.sqrt(np.diag(pose.covariance))
    print("                        x         y         z")
    for label, values in (
        ("position [mm]", 1e3 * pose.position),
        ("  truth", 1e3 * truth.position),
        ("  std", 1e3 * std[:3]),
        ("rotation [°]", np.degrees(so3.log(pose.rotation))),
        ("  truth", np.degrees(so3.log(truth.rotation))),
        ("  std", np.degrees(std[3:])),
    ):
        print(f"{label:16s}", *(f"{value:9.2f}" for value in values))
    distance = 1e3 * np.linalg.norm(pose.position - truth.position)
    angle = np.degrees(so3.angle_between(pose.rotation, truth.rotation))
    print(f"error            {distance:.2f} mm, {angle:.2f} degrees")
    print(f"confidence       {pose.confidence:.3f}")


if __name__ == "__main__":
    arguments = parser.parse_args()
    if arguments.seed < 0:
        parser.error(f"--seed: found {arguments.seed}, expected at least 0")
    if arguments.output.exists() and any(arguments.output.iterdir()):
        parser.error(f"--output {arguments.output}: in use, expected a new or an empty folder")
    main(arguments.seed, arguments.output)
