import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers.log_writers import CAMERAS, make_content, write_store, write_store_by_zarr
from tests.helpers.reading import frames_of, peak_memory, recovered
from tests.helpers.recording_stubs import tiny_rig
from tracker.errors import LogError
from tracker.logs.datasets import read_steps
from tracker.logs.hdf5_writer import write_hdf5

pytest.importorskip("lmdb", reason="datasets: no module lmdb")
pytest.importorskip("numcodecs", reason="datasets: no module numcodecs")

COMPRESSORS = [None, {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1}]


@pytest.mark.parametrize("reorder", [True, False])
@pytest.mark.parametrize("coding", ["vlen-bytes", "vlen-array"])
@pytest.mark.parametrize("compressor", COMPRESSORS, ids=["plain", "blosc"])
def test_stores_are_read(tmp_path, reorder, coding, compressor):
    content = make_content(5)
    folder = write_store(tmp_path / "x.zarr", content, reorder=reorder, coding=coding, compressor=compressor)
    for path in (folder, folder / "data.mdb"):
        with tracker.open_log(path) as log:
            assert len(log) == 5
            assert log.camera_names == CAMERAS
            assert log.image_sizes == ((28, 24),) * 3
            for k, frame in enumerate(log):
                assert frame.timestamp == pytest.approx(0.1 * k)
                np.testing.assert_array_equal(frame.images, content.images(k))
            np.testing.assert_array_equal(log[1].images, content.images(1))
            assert log.rig is None


def test_a_store_keeps_its_raw_pixels_in_an_hdf5_log(tmp_path):
    content = make_content(3)
    for reorder in (True, False):
        with tracker.open_log(write_store(tmp_path / f"{reorder}.zarr", content, reorder=reorder)) as log:
            write_hdf5(tmp_path / f"{reorder}.h5", log, tiny_rig(), lambda _: None)
        with tracker.open_log(tmp_path / f"{reorder}.h5") as log:
            np.testing.assert_array_equal([frame.raw for frame in log], content.raw)


def test_jpeg_is_read_about_right(tmp_path):
    content = make_content(2)
    content.raw[:] = 90
    with tracker.open_log(write_store(tmp_path / "x.zarr", content, codec=".jpg")) as log:
        assert np.abs(log[1].images[2].astype(int) - 90).max() <= 3


@pytest.mark.parametrize("alpha", [0, 1])
def test_images_in_colour_are_given_as_they_are_but_for_what_is_transparent(alpha, tmp_path):
    content = make_content(2)
    pixels = np.pad([content.images(k) for k in range(2)], [(0, 0)] * 4 + [(0, alpha)])
    folder = write_store(tmp_path / "x.zarr", dataclasses.replace(content, raw=pixels), reorder=False)
    edit(folder, "images/.zattrs", head(image_shape=[24, 28]))
    for frame in frames_of(folder):
        np.testing.assert_array_equal(frame.images, content.images(frame.index))
        assert frame.raw is None


@pytest.mark.parametrize(
    ("shown", "ends", "stamps", "starts"),
    [
        # Frame 2 was seen by no step; frames 3 and 4 are of another episode.
        ([0] * 5 + [3] * 6 + [9] * 5 + [12] * 4, [10, 19], [0, 0.1, 0.16, 0.22, 0.32], (0, 3)),
        # No step saw the first two of ten, which change neither episodes nor the clock.
        (3 * np.repeat(np.arange(2, 10), 5), [19, 39], np.arange(-2, 8) / 10, (0, 6)),
        # Nor the last two; the second episode may lack its end.
        (3 * np.repeat(np.arange(8), 5), [19, 39], np.arange(10) / 10, (0, 4)),
        (3 * np.repeat(np.arange(8), 5), [19], np.arange(10) / 10, (0, 4)),
        ([], [], np.arange(3) / 10, (0,)),
    ],
)
def test_stamps_are_those_of_the_steps_that_saw_the_images(shown, ends, stamps, starts, tmp_path):
    content = make_content(len(stamps))
    with tracker.open_log(write_store(tmp_path / "x.zarr", content, shown=shown, ends=ends)) as log:
        assert [frame.timestamp for frame in log] == pytest.approx(stamps)
        assert log.episode_starts == starts


@pytest.mark.parametrize("ends", [[], [19, 10], [-1, 19], [10, 10], [10, 20]])
def test_episodes_that_end_where_none_can_are_refused(tmp_path, ends):
    folder = write_store(tmp_path / "x.zarr", make_content(5), shown=[0] * 10 + [12] * 10, ends=ends)
    with pytest.raises(LogError, match=r"episode_ends: found .*, expected steps that increase, up to 19"):
        tracker.open_log(folder)


def edit(folder: Path, key: str, change) -> None:
    import lmdb

    with (
        lmdb.open(str(folder), map_size=1 << 24) as environment,
        environment.begin(write=True) as transaction,
    ):
        new = change(transaction.get(key.encode()))
        transaction.put(key.encode(), new) if new is not None else transaction.delete(key.encode())


def head(**entries):
    """Change entries of an array's head."""
    return lambda data: json.dumps({**json.loads(data), **entries}).encode()


SHOWN, IMAGES = "obs_to_image_index/.zarray", "images/.zarray"


@pytest.mark.parametrize(
    ("key", "change", "frames", "message"),
    [
        (IMAGES, lambda data: None, None, "images is missing"),
        (IMAGES, lambda data: b"{}", None, "expected zarr 2"),
        (IMAGES, lambda data: b"[", None, "no JSON"),
        (IMAGES, head(filters=[{"id": "pickle"}]), None, "coded as .'pickle'"),
        *[
            (IMAGES, head(compressor={"id": packer}), None, f"packed by '{packer}'")
            for packer in ("pickle", "zlib", "gzip", "bz2", "lzma", "lz4", "zstd")
        ],
        (IMAGES, head(shape=[16]), None, "multiple of 3"),
        ("images/.zattrs", head(n_cameras=0), None, "n_cameras: found 0, expected 1 to 16"),
        ("images/.zattrs", head(image_shape=[24]), None, "image_shape"),
        ("images/.zattrs", head(compression="video"), None, "found video, expected 'image'"),
        ("images/.zattrs", head(image_shape=[24, 30]), 0, "28×24 px, expected 30×24"),
        ("images/1", lambda data: None, 3, "block 1 is missing"),
        ("images/1", lambda data: data[:-9], 3, "images: block 1: found items that are damaged"),
        ("images/1", lambda data: b"\xff\xff\xff\xff" + data[4:], 3, "items stated"),
        ("images/1", lambda data: b"\x03" + data[1:], 3, "images: block 1: found 3 items, expected 4"),
        ("images/1", lambda data: data[:150] + bytes([data[150] ^ 1]) + data[151:], 4, "checksum"),
        # What would take memory or time without end.
        (IMAGES, head(shape=[10**12]), None, "images: found 1000000000000 items stated"),
        (SHOWN, head(shape=[10**12]), None, "found 1000000000000 items stated"),
        (SHOWN, head(shape=[10**7], chunks=[1]), None, "10000000 blocks stated"),
        (SHOWN, head(chunks=[0.5]), None, "expected zarr 2"),
        (SHOWN, head(dtype="<f8"), None, "found float64, expected whole numbers"),
        (SHOWN, head(shape=[40], fill_value=1e300), None, "fill_value: found 1e"),
        (SHOWN, head(shape=[40], fill_value=None), None, "obs_to_image_index: block 2 is missing"),
        (SHOWN, head(shape=[8, 1, 1], chunks=[4, 1, 1]), None, "expected zarr 2"),
        (SHOWN, head(chunks=[1 << 25]), None, "expected zarr 2"),
        (SHOWN, head(shape=[8, 1], chunks=[4, 1]), None, r"shape \(8, 1\), expected 1 ax"),
        (SHOWN, head(order="A"), None, "expected zarr 2"),
        ("obs_to_image_index/0", lambda data: data[:-1], None, "found 31 bytes, expected 4 numbers of 8"),
        ("obs_to_image_index/0", lambda data: data[:24] + b"\7" + data[25:], None, "step 3: found 7, exp"),
        ("episode_ends/.zarray", head(shape=[2, 1], chunks=[4, 1]), None, r"shape \(2, 1\), expected 1 axes"),
        ("episode_ends/.zarray", head(dtype="<f8"), None, "found float64, expected whole numbers"),
        (IMAGES, lambda data: data[:-1] + b" " * (1 << 20) + b"}", None, "at most 1048576"),
    ],
)
def test_damage_is_named(tmp_path, key, change, frames, message):
    shown = None if frames is not None else [0, 3, 6, 9, 12, 12, 12, 12]
    ends = shown and [3, 7]
    folder = write_store(tmp_path / "x.zarr", make_content(5), shown=shown, ends=ends)
    edit(folder, key, change)
    if frames is not None:
        assert len(recovered(folder, message)[1]) == frames
    else:
        with pytest.raises(LogError, match=message):
            tracker.open_log(folder)


def test_an_episode_whose_first_step_sees_an_old_image_begins_with_the_next_that_it_sees(tmp_path):
    shown = 3 * np.array([0] * 5 + [1] * 6 + [4] * 5)  # step 10 is of the second episode
    folder = write_store(tmp_path / "x.zarr", make_content(5), shown=shown, ends=[9, 15])
    with tracker.open_log(folder) as log:
        assert log.episode_starts == (0, 4)
    assert [one.frames for one in read_steps(folder).episodes()] == [range(2), range(4, 5)]


def test_hours_of_steps_are_read_without_the_columns_that_are_not_needed(tmp_path):
    rows, width = 400_000, 139
    folder = write_store(tmp_path / "x.zarr", make_content(2), shown=[0, 3], ends=[1])
    table = {"zarr_format": 2, "dtype": "<f4", "shape": [rows, width], "chunks": [1000, 50], "fill_value": 0}
    table |= {"compressor": None, "filters": None}
    edit(folder, SHOWN, head(shape=[rows], chunks=[rows]))
    edit(folder, "obs_to_image_index/0", lambda _: None)
    edit(folder, "observations/.zarray", lambda _: json.dumps(table).encode())
    with peak_memory() as used:
        steps = read_steps(folder)
    assert (steps.task, steps.observed["joints"].shape) == ("lift", (rows, 9))
    assert used[0] < 4 * rows * width


@pytest.mark.parametrize("separator", [".", "/"])
def test_tables_are_read_whichever_way_their_blocks_are_named(tmp_path, separator, rng):
    rows, given = rng.random((20, 97), np.float32), {"shown": [0] * 20, "ends": [19], "separator": separator}
    steps = read_steps(write_store(tmp_path / "x.zarr", make_content(1), observations=rows, **given))
    np.testing.assert_array_equal(steps.observed["position"], rows[:, 42:45])
    np.testing.assert_array_equal(steps.observed["joints"], rows[:, 69:78])


@pytest.mark.parametrize("inner", ["zlib", "zstd", "lz4"])
def test_no_more_is_unpacked_than_a_block_holds(tmp_path, inner):
    import numcodecs

    compressor = {"id": "blosc", "cname": inner, "clevel": 9, "shuffle": 0}
    folder = write_store(
        tmp_path / "x.zarr", make_content(2), shown=[0, 0, 0, 3, 3, 3], compressor=compressor
    )
    assert len(frames_of(folder)) == 2
    packed = numcodecs.get_codec(compressor).encode(bytes(20_000_000))
    edit(folder, "obs_to_image_index/0", lambda data: bytes(packed))
    message = r"index: block 0: cannot be unpacked: .*of 20000000 bytes stated"
    with peak_memory() as used, pytest.raises(LogError, match=message):
        tracker.open_log(folder)
    assert used[0] < 5_000_000


def test_a_truncated_store_is_noticed_before_it_is_mapped(tmp_path):
    folder = write_store(tmp_path / "x.zarr", make_content(5))
    data = (folder / "data.mdb").read_bytes()
    for size in (0, 10, 3000, 5000, len(data) // 2, len(data) - 4096):
        (folder / "data.mdb").write_bytes(data[:size])
        with pytest.raises(LogError):
            tracker.open_log(folder)


def test_a_missing_extra_is_named(tmp_path, monkeypatch):
    folder = write_store(tmp_path / "x.zarr", make_content(1))
    monkeypatch.setitem(sys.modules, "numcodecs", None)
    with pytest.raises(LogError, match=r"pip install .*\[datasets\]"):
        tracker.open_log(folder)


def test_stores_written_by_zarr_are_read(tmp_path):
    content = make_content(3)
    frames = frames_of(write_store_by_zarr(tmp_path / "x.zarr", content, shown=np.repeat([0, 3, 6], 5)))
    assert [frame.timestamp for frame in frames] == pytest.approx([0, 0.1, 0.2])
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.images, content.images(k))
