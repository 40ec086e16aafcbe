"""Pictures of a cube that lies in some places."""

import functools

import numpy as np

from synthetic.camera.sensor import Sensor
from tests.helpers.filmed import RIG
from tests.helpers.kept_stills import take
from tests.helpers.stills import Still, posed_scene
from tracker.geometry import so3
from tracker.objects.model import load_object

PLACES = ((-0.08, 0.03), (0.02, 0.09), (0.07, -0.05), (-0.03, -0.08), (0.0, 0.01), (0.1, 0.05))


@functools.cache
def rests() -> tuple[Still, ...]:
    """Pictures of each place, drawn once."""
    rng = np.random.default_rng(15)
    model = load_object("cube_v2")
    poses = [(np.array([*place, 0.0325]), so3.exp([0, 0, k])) for k, place in enumerate(PLACES)]
    return tuple(take(posed_scene(model, pose, rng), RIG.cameras, Sensor.realistic(), rng) for pose in poses)
