"""What the samples of the pages find around them."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.docs.samples import blocks
from tests.helpers import ROOT
from tests.helpers.log_writers import write_picture

BGR = {"red": (40, 50, 190), "green": (60, 150, 70), "blue": (150, 60, 20)}


@pytest.fixture(scope="module")
def working(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages speak of: tracker-demo, my_images, my_recording, my_object.toml, …"""
    folder = tmp_path_factory.mktemp("pages")
    demo, few = ROOT / "tracker" / "demo", shutil.ignore_patterns("00000[3-9]", "00001*")
    shutil.copytree(demo, folder / "tracker-demo")
    shutil.copytree(demo, folder / "my_recording")
    goal = '{"difficulty": 1, "goal": {"position": [0, 0, 0.0325], "orientation": [0, 0, 0, 1]}}'
    (folder / "my_recording" / "goal.json").write_text(goal)
    for number in range(2):
        shutil.copytree(folder / "my_recording", folder / "episodes" / f"{number:04d}", ignore=few)
    shutil.copytree(ROOT / "examples" / "dice", folder / "examples" / "dice")
    for number in range(2):
        image = np.random.default_rng(number).normal(110, 4, (90, 120, 3))
        for index, (color, bgr) in enumerate(BGR.items()):
            mask = np.zeros((90, 120), np.uint8)
            mask[20 + 9 * number :, 10 + 40 * index :][:30, :30] = 255
            image[mask > 0] = bgr
            write_picture(folder / "my_images" / f"0{number}_mask_{color}.png", mask)
        write_picture(folder / "my_images" / f"0{number}_image.png", np.rint(image).astype(np.uint8))
    objects = [block for block in blocks("toml") if re.search("^size = ", block, re.MULTILINE)]
    (folder / "my_object.toml").write_text(objects[0], encoding="utf-8")
    return folder
