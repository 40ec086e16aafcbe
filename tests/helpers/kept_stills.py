"""Pictures that are drawn once for all tests, processes and runs: they are kept on disk by what they show.

For tests of what is found in pictures; those of the renderer draw their own.
"""

import dataclasses
import functools
import hashlib
import io
import json
import pickle
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.data.fingerprint import fingerprint
from benchmarks.data.plan import CACHE
from synthetic.camera.sensor import Sensor
from synthetic.scene import PlatformScene
from tests.helpers import stills
from tests.helpers.stills import Still
from tracker import Camera, CuboidModel, load_object
from tracker.files import write_whole

__all__ = ["bare", "take"]


@functools.cache
def _folder() -> Path:
    folder = CACHE / f"stills-{fingerprint('synthetic.stills')}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def take(
    scene: PlatformScene, cameras: Sequence[Camera], sensor: Sensor, rng: np.random.Generator, **more: object
) -> Still:
    """As `synthetic.stills.take`, and `rng` is left as that leaves it."""
    fresh = tuple(map(dataclasses.replace, cameras))  # without values that others have cached in them
    asked = pickle.dumps((scene, fresh, sensor, rng.bit_generator.state, sorted(more.items())))
    path = _folder() / f"{hashlib.sha256(asked).hexdigest()[:32]}.npz"
    if (kept := _read(path, scene, rng)) is not None:
        return kept
    still = stills.take(scene, cameras, sensor, rng, **more)
    arrays = {f"image{c}": image for c, image in enumerate(still.images)}
    arrays |= {f"labels{c}": labels for c, labels in enumerate(still.labels)}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays, seen=still.visible_fraction, state=json.dumps(rng.bit_generator.state))
    write_whole(path, buffer.getvalue())
    return still


def bare(
    model: CuboidModel | str,
    cameras: Sequence[Camera],
    seed: object,
    sensor: Sensor | None = None,
    *,
    kind: str | None = None,
    **more: object,
) -> Still:
    """Pictures of a scene without fingers, all drawn from a seed; a model may go by its name."""
    rng = np.random.default_rng(seed)
    scene = stills.bare_scene(load_object(model) if isinstance(model, str) else model, rng, kind=kind)
    return take(scene, cameras, sensor or Sensor.realistic(), rng, **more)


def _read(path: Path, scene: PlatformScene, rng: np.random.Generator) -> Still | None:
    """What is kept; None where nothing is, or what is damaged."""
    try:
        with np.load(path, allow_pickle=False) as kept:
            count = len(kept["seen"])
            images = [kept[f"image{c}"] for c in range(count)]
            labels = [kept[f"labels{c}"] for c in range(count)]
            still = Still(scene, images, labels, kept["seen"])
            rng.bit_generator.state = json.loads(kept["state"].item())
            return still
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
