"""Make the recording for `tracker demo`: a short film of the simulated platform, with its ground truth.

    python scripts/make_demo.py

Writes tracker/demo: 20 frames at 10 Hz as JPEG, the cameras' calibration, and truth.json.
"""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np

from synthetic.camera.rigs import sized, standard_rig
from synthetic.frames import frames
from tracker.geometry import so3

FOLDER = Path(__file__).parents[1] / "tracker" / "demo"
OBJECT, COUNT, SEED, QUALITY = "cube_v2", 20, 5, 95


def main() -> None:
    """Simulate and write the recording."""
    rig = sized(standard_rig(), 270)
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    rig.save(FOLDER)
    truth = []
    for frame in frames(OBJECT, COUNT, SEED, rig=rig, sequence=True, kind="mixed"):
        folder = FOLDER / f"{frame.index:06d}"
        folder.mkdir()
        for name, image in zip(rig.names, frame.images, strict=True):
            cv2.imwrite(str(folder / f"{name}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        (state,) = frame.objects
        truth.append(
            {
                "position": np.round(state.position, 6).tolist(),
                "orientation": np.round(so3.quaternion(state.rotation), 6).tolist(),
            }
        )
    text = json.dumps({"object": OBJECT, "poses": truth}, indent=1)
    (FOLDER / "truth.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
