"""A cube that is pushed over the table before the platform's cameras, and what a tracker makes of it."""

import dataclasses

import numpy as np

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers.kept_stills import take
from tests.helpers.stills import posed_scene
from tracker.geometry import so3

DT = 0.1
MODEL = tracker.load_object("cube_v2")


def pose_at(seconds):
    """Still, then pushed at 0.1 m/s and turned at 60 degrees a second, and still again."""
    moved = np.clip(seconds - 0.4, 0.0, 0.8)
    place = np.array([-0.03, -0.05, 0.0325]) + moved * np.array([0.06, 0.08, 0.0])
    return place, so3.exp([0.0, 0.0, 0.4 + np.radians(60) * moved])


def shot(rig, pose, seed, sensor=None):
    """Images of the cube in a pose, or of the empty arena."""
    scene, noise = posed_scene(MODEL, pose, np.random.default_rng(30)), np.random.default_rng([30, seed])
    return take(scene, rig.cameras, sensor or Sensor.realistic(), noise, points=3).images


def image_of(rig, c, pose, seed):
    """One camera's image of the cube in a pose."""
    return shot(tracker.CameraRig((rig[c],)), pose, 3 * seed + c)[0]


def new(rig, **options):
    return tracker.ObjectTracker(MODEL, rig, tracking=tracker.TrackingOptions(**options))


def play(one, film, start=0.0, dt=DT, first=0):
    """Answers to images at even stamps, of which `start` is that of number 0."""
    return [one.update(images, start + dt * k) for k, images in enumerate(film, first)]


def has_seen(rig, film, **more):
    """A tracker after a film."""
    one = new(rig)
    play(one, film, **more)
    return one


def off(pose, truth):
    """Error [mm, degrees]."""
    place, rotation = truth
    return 1e3 * np.linalg.norm(pose.position - place), np.degrees(so3.angle_between(pose.rotation, rotation))


def within(pose, truth, millimetres=1.0, degrees=1.0):
    shift, turn = off(pose, truth)
    return shift < millimetres and turn < degrees


def near(answer, truth, *limits):
    """Whether both poses of an answer are near the truth."""
    poses = answer.object_pose, answer.filtered_object_pose
    return all(within(pose, truth, *limits) for pose in poses)


def honest(answer, truth):
    """Whether no pose of an answer is wrong and held to be right."""
    poses = [pose for pose in (answer.object_pose, answer.filtered_object_pose) if pose is not None]
    return all(pose.confidence < 0.5 or within(pose, truth, 5.0, 5.0) for pose in poses)


def bits(*observations):
    """Everything in answers but how long they took."""
    result = []
    for one in observations:
        result += [one.status, one.reason]
        for pose in (one.object_pose, one.filtered_object_pose):
            fields = {} if pose is None else dataclasses.asdict(pose)
            result.append([(key, np.asarray(value).tobytes()) for key, value in fields.items()])
    return result
