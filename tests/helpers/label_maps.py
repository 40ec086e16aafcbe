"""Label maps as an object is searched for in them."""

import numpy as np

from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from tests.helpers.kept_stills import bare
from tracker.pose.scale import label_camera
from tracker.pose.views import PICTURE


def drawn(model, seed):
    """Cameras of reduced images, perfect label maps of an object without fingers there, and the truth."""
    cameras = default_cameras()
    truth = bare(model, cameras, seed, Sensor.clean())
    small = [label_camera(camera, 2) for camera in cameras]
    # The middle one of each 2×2 block would shift by half a pixel; any of the four is as good here.
    labels = np.stack([image[::2, ::2] for image in truth.labels])
    return small, labels, truth


def pictures_of(labels):
    """(C,) of PICTURE of label maps (C, h, w) that all count; the images are twice as large."""
    pictures = np.zeros(len(labels), PICTURE)
    pictures["height"], pictures["width"] = 2 * labels.shape[1], 2 * labels.shape[2]
    pictures["used"], pictures["colored"] = True, (labels > 0).sum(axis=(1, 2))
    return pictures
