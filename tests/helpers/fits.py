"""Fits that no picture was needed for."""

import dataclasses
import math

import numpy as np

from tests.helpers.consistency import pose_error
from tracker.objects.model import load_object
from tracker.pose.evidence import NUMBERS, evidence_of
from tracker.pose.fit import SEEN, Evidence, Fit

COVARIANCE = np.diag(np.repeat(np.square([0.3e-3, math.radians(0.3)]), 3))
HOME = np.array([0.02, -0.03, 0.0325])
LABELS = load_object("cube_v2").face_labels
VISIBLE = (0, 2, 4)


def with_cameras(fit, which=slice(None), **fields):
    """The fit, of which the cameras `which` say something else, with the evidence of it all."""
    cameras = fit.cameras.copy()
    for name, value in fields.items():
        cameras[name][which] = value
    faces = np.zeros_like(cameras["faces"])
    for k, face in enumerate(VISIBLE):
        faces[:, face, LABELS[face]] = (cameras["agree"] + k) // 3
        faces[:, face, 0] = (cameras["missing"] + k) // 3
    # One face is in another's colour.
    faces[:, VISIBLE[0], LABELS[VISIBLE[1]]] += cameras["wrong"].astype(int)
    cameras["faces"] = cameras["inner"] = faces
    evidence = Evidence(*evidence_of(cameras, np.asarray(LABELS), fit.stands, NUMBERS))
    return dataclasses.replace(fit, cameras=cameras, evidence=evidence)


def deviation(fit, other):
    """How far a fit is from another, in the other's standard deviations."""
    error = pose_error(fit.position, fit.rotation, other.position, other.rotation)
    return np.abs(error / np.sqrt(np.diag(other.covariance))).max()


def made_fit(position=HOME, rotation=None, *, sure=True, cameras=3, covariance=COVARIANCE):
    """A fit as of an object in full view, or with many pixels and pieces of edges that do not agree."""
    fields = {
        "expected": 40.0, "usable": 38.0 if sure else 20.0, "inliers": 36.0 if sure else 12.0,
        "squares": 0.36 if sure else 3.0, "noise": 0.1, "blur": 0.5,
        "predicted": 410, "agree": 400 if sure else 240,
        "missing": 10 if sure else 150, "wrong": 0 if sure else 30, "extra": 4 if sure else 60,
    }  # fmt: skip
    rotation = np.eye(3) if rotation is None else rotation
    fit = Fit(np.array(position, dtype=np.float64), rotation, covariance, np.zeros(3, SEEN), True)
    return with_cameras(fit, slice(cameras), **fields)
