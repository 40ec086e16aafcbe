"""Damaged files of every kind: an error in one line, fewer frames, or the same frames.

Files are damaged from a seed: cut off, bits flipped anywhere or where lengths stand, numbers overwritten,
pieces doubled or left out, texts with what parsers stumble over. FUZZ_VARIANTS=200 reads more of them.

What no reader can notice, and these tests therefore allow:
- In a plain native log nothing protects pixels; a flipped bit there gives another image. Nor small changes
  of stamps that stay in order, nor of a pose that stays one. The flag `continuous` carries nothing.
- In a gzipped log the checksum is at the end: frames given before are in doubt when it disagrees, and that is
  stated then.
- In an HDF5 log images are protected by gzip's checksum; stamps, poses and calibration are not, as above.
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.fuzz import Sample, answers_to, frames_of
from tests.helpers.log_writers import make_content, native_bytes, write_hdf5, write_native, write_store
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import tiny_rig
from tests.helpers.stated_sizes import encoded
from tests.logs.test_hdf5 import SAMPLES as HDF5
from tests.logs.test_native import SAMPLES as NATIVE
from tracker.objects.model import load_object, to_toml
from tracker.poses.file import write_poses
from tracker.viz import write_film

VARIANTS = int(os.environ.get("FUZZ_VARIANTS", "16"))
"""Of each file; whole multiples of 8 have every kind of damage as often."""

OF_USERS = ("bmp", "tiff", "webp")
"""Formats of pictures that no recording has."""

MADE = (
    *(*OF_USERS, "native", "gzipped", "hdf5", "poses", "lmdb", "zarr", "png", "jpeg"),
    *("png of a log", "jpeg of a log", "recording.toml", "stamps.csv", "film", "object.toml", "arena.toml"),
    *("goal.json", "dice.json", "ground_truth.json", "camera60.yml"),
)


def made(folder: Path) -> list[Sample]:
    """A small file of each kind."""
    content, rng = make_content(4), np.random.default_rng(0)
    places = {name: folder / name.replace(" ", "_") for name in MADE}
    for place in places.values():
        place.mkdir()

    def sample(name: str, content: bytes | Path, reader: str, file: str, **options: object) -> Sample:
        data = content.read_bytes() if isinstance(content, Path) else content
        return Sample(name, data, reader, places[name] / file, **options)

    def beside(name: str, content: bytes, *files: str) -> None:
        for file in files:
            (places[name] / file).parent.mkdir(exist_ok=True)
            (places[name] / file).write_bytes(content)

    store = write_store(folder / "x.zarr", content, shown=np.repeat([0, 3, 6, 9], 3), ends=[5])
    data = (store / "data.mdb").read_bytes()
    pages = tuple((at, at + 200) for at in range(0, len(data), 4096))
    # Where each array's heads and the lengths of its items are.
    marks = [
        data.rindex(mark) for mark in (b"images/.zarray", b"images/.zattrs", b"images/0", b"image_index/.z")
    ]
    tiny_rig().save(folder / "rig")
    yaml = next((folder / "rig").glob("*.yml"))
    picture = content.images(0)[0]
    png, jpg = encoded("png", picture), encoded("jpg", picture)
    beside("png of a log", png, "0/camera180.png", "0/camera300.png")
    beside("jpeg of a log", jpg, "0/camera180.jpg", "0/camera300.jpg")
    recording = b'[cameras]\nleft = "left/*.png"\nright = "r*.png"\n'
    for name in ("recording.toml", "stamps.csv"):
        beside(name, recording, "recording.toml")
        beside(name, png, "left/1.png", "left/2.png", "r1.png", "r2.png")
    larger = [content.images(k)[0].repeat(4, axis=0).repeat(4, axis=1) for k in range(4)]
    write_film(folder / "film.mp4", larger, rate=10)
    beside("ground_truth.json", png, "000000/camera60.png")
    frames = {"frames": [{"frame": "000000", "timestamp": 1.5}], "settings": {"rate": 10.0, "sequence": True}}
    goal = {"difficulty": 4, "goal": json.dumps({"position": [0, 0, 0.03], "orientation": [0, 0, 0, 1]})}
    dice = {"goal": (0.022 * np.mgrid[-2:3, -2:3, :1].reshape(3, -1).T + [0, 0, 0.011]).tolist()}
    write_poses(folder / "poses.h5", random_poses(rng, 6))
    return [
        sample("native", native_bytes(content, poses=1), "log", "log", heads=((0, 60),)),
        sample("gzipped", write_native(folder / "gz", content, packed=True), "log", "log"),
        sample("hdf5", write_hdf5(folder / "h5", content, poses=True), "log", "log", heads=((0, 9000),)),
        sample("poses", folder / "poses.h5", "poses", "poses.h5", heads=((0, 3000),)),
        sample("lmdb", data, "log around", "data.mdb", heads=pages),
        sample("zarr", data, "log around", "data.mdb", heads=tuple((at, at + 220) for at in marks)),
        sample("png", png, "picture", "a.png", heads=((8, 33),)),
        sample("jpeg", jpg, "picture", "a.jpg", heads=((0, 200),)),
        *(
            sample(kind, encoded(kind, picture), "picture", f"a.{kind}", heads=((0, 60),))
            for kind in OF_USERS
        ),
        sample("png of a log", png, "log of frames", "0/camera60.png", heads=((8, 33),)),
        sample("jpeg of a log", jpg, "log of frames", "0/camera60.jpg", heads=((0, 200),)),
        sample("recording.toml", recording, "log around", "recording.toml"),
        sample("stamps.csv", b"1.5,1.501\n1.6,1.601\n", "log around", "stamps.csv"),
        sample("film", folder / "film.mp4", "log around", "camera60.mp4"),
        sample("object.toml", to_toml(load_object("cube_v2")).encode(), "object", "object.toml"),
        sample("arena.toml", b"radius = 0.2\ntable_std = [0.008, 0.017]\n", "arena", "arena.toml"),
        sample("goal.json", json.dumps(goal).encode(), "job goal", "goal.json"),
        sample("dice.json", json.dumps(dice).encode(), "dice goal", "goal.json"),
        sample("ground_truth.json", json.dumps(frames).encode(), "log around", "ground_truth.json"),
        sample("camera60.yml", yaml, "calibration", "camera60.yml"),
    ]


@pytest.fixture(scope="module")
def of_made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """What became of each damaged file, by the sample that it was."""
    return answers_to(made(tmp_path_factory.mktemp("made")), VARIANTS)


@pytest.fixture(scope="module")
def of_recorded(real: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    folder, samples = tmp_path_factory.mktemp("recorded"), []
    for name in (*NATIVE, *HDF5):
        heads = ((0, 33 if name in NATIVE else 6000),)
        samples.append(Sample(name, (real / "logs" / name).read_bytes(), "log", folder / name, heads))
    return answers_to(samples, VARIANTS)


def all_read(answers: list[Any]) -> list[Any]:
    assert len(answers) == VARIANTS
    assert [(seed, one) for seed, one in enumerate(answers) if isinstance(one, Exception)] == []
    return answers


@pytest.mark.parametrize("name", MADE)
def test_a_damaged_file_of_any_kind_gives_an_error_in_one_line_or_what_it_says(of_made, name):
    faults = [one[0][0] if isinstance(one, list) else one for one in all_read(of_made[name])]
    assert sum(isinstance(fault, str) for fault in faults) > 0.2 * VARIANTS


@pytest.mark.parametrize("name", [*NATIVE, *HDF5])
def test_damage_gives_errors_or_frames_that_are_whole(real: Path, of_recorded, name):
    _, whole = frames_of(real / "logs" / name, recover=False)
    noticed, recovered = 0, 0
    for seed, ((fault, frames), (known, given)) in enumerate(all_read(of_recorded[name])):
        assert (fault is None) <= (known is None), seed
        if name not in NATIVE[:2] and fault is None:
            # Checksums: without notice images are those of the whole recording.
            assert frames == whole, seed
        same = [number for number, _ in frames] == [number for number, _ in whole]
        assert fault is not None or same, seed
        assert len(given) >= len(frames), seed
        if name in HDF5:
            assert all(frame in whole for frame in given), seed
        noticed += fault is not None
        recovered += bool(given) and known is not None
    assert noticed > 0.4 * VARIANTS
    assert recovered > 0.05 * VARIANTS
