"""Small writers of the recordings that tests read."""

import gzip
import json
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from tests.helpers.needs import lack

CAMERAS = ("camera60", "camera180", "camera300")
START = 1_605_000_000.0
POSE = (0.01, -0.02, 0.0325, 0.0, 0.6, 0.0, 0.8, 0.9)


@dataclass(frozen=True)
class Content:
    """What a recording holds: raw pixels (n, C, H, W), stamps (n,) and (n, C) [s], poses (n, 8)."""

    raw: np.ndarray
    stamps: np.ndarray
    camera_stamps: np.ndarray
    poses: np.ndarray

    def images(self, frame: int) -> np.ndarray:
        """What a reader should give: (C, H, W, 3) BGR."""
        return np.stack([cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR) for raw in self.raw[frame]])


def make_content(frames: int = 5, size: int = 24) -> Content:
    """Noise with stamps at 10 Hz; frame 0 has no pose."""
    rng = np.random.default_rng(frames)
    stamps = START + 0.1 * np.arange(frames)
    poses = np.tile(POSE, (frames, 1))
    poses[:, 0] += 0.001 * np.arange(frames)
    poses[:1] = 0
    return Content(
        raw=rng.integers(0, 256, (frames, len(CAMERAS), size, size + 4), np.uint8),
        stamps=stamps,
        camera_stamps=stamps[:, None] + 0.001 * np.arange(len(CAMERAS)),
        poses=poses,
    )


def native_bytes(
    content: Content, *, poses: int = 0, stamped: bool = True, timed: bool = False, bgr: bool = False
) -> bytes:
    """A native log; `timed`: poses have a ninth leading number."""
    count = len(content.raw)
    parts = [struct.pack("<IQ", 1, count) if stamped else struct.pack("<Q", count)]
    for k in range(count):
        if stamped:
            parts.append(struct.pack("<d", 1000 * content.stamps[k]))
        for camera, pixels in enumerate(content.images(k) if bgr else content.raw[k]):
            parts.append(struct.pack("<iiiB", *pixels.shape[:2], 16 if bgr else 0, 1))
            parts.append(pixels.tobytes() + struct.pack("<d", content.camera_stamps[k, camera]))
        for which in range(poses):
            time = [content.stamps[k]] if timed else []
            parts.append(np.array([*time, *content.poses[max(0, k - which)]], "<f8").tobytes())
    return b"".join(parts)


def write_native(path: Path, content: Content, *, packed: bool = False, **options: object) -> Path:
    data = native_bytes(content, **options)
    path.write_bytes(gzip.compress(data, 1) if packed else data)
    return path


def write_hdf5(
    path: Path,
    content: Content,
    *,
    version: tuple[int, int] = (2, 1),
    poses: bool = False,
    has_pose: bool = True,
    wide_confidence: bool = False,
    names: bool = True,
    frame_rate: str = "none",
    chunk: int | None = 1,
) -> Path:
    """An HDF5 log; `frame_rate`: where its attribute stands, `none`, `group` or `root`."""
    cameras, rows, columns = content.raw.shape[1:]
    with h5py.File(path, "w") as file:
        file.attrs.update(magic=0x3CDA7A00, format_version=version[0], num_cameras=cameras)
        file.attrs.update(image_width=columns, image_height=rows)
        if version >= (2, 1):
            file.attrs["format_version_minor"] = version[1]
            file["sensor_data_timestamps"] = 1000 * content.stamps
        options = {} if chunk is None else {"chunks": (chunk, cameras, rows, columns), "compression": "gzip"}
        file.create_dataset("images", data=content.raw, **options)
        file["timestamps"] = content.camera_stamps
        if names:
            file["camera_names"] = [name.encode() for name in CAMERAS]
        for name in CAMERAS if version[0] > 1 else ():
            group = file.create_group(f"camera_info/{name}")
            group["camera_matrix"] = [[29.0, 0, 13.5], [0, 29.5, 11.5], [0, 0, 1]]
            group["distortion_coefficients"] = [[-0.2, 0.1, 0.001, 0.0, 0.0]]
            group["tf_world_to_camera"] = np.eye(4) + 1e-5
            group["tf_world_to_camera"][3] = (0, 0, 0, 1)
            if frame_rate != "none":
                place = group if frame_rate == "group" else file
                place.attrs["frame_rate_fps" if frame_rate == "group" else f"/{name}/frame_rate_fps"] = 10.0
        if poses:
            group = file.create_group("object_pose")
            if has_pose:
                group["has_pose"] = content.poses[:, 7] > 0
            group["position"], group["orientation"] = content.poses[:, :3], content.poses[:, 3:7]
            group["confidence"] = content.poses[:, 7:] if wide_confidence else content.poses[:, 7]
    return path


def quadrants(raw: np.ndarray) -> np.ndarray:
    """Colour planes side by side, as data sets reorder pixels."""
    return np.block([[raw[0::2, 0::2], raw[0::2, 1::2]], [raw[1::2, 1::2], raw[1::2, 0::2]]])


def write_store(
    folder: Path,
    content: Content,
    *,
    reorder: bool = True,
    codec: str = ".png",
    coding: str = "vlen-bytes",
    compressor: dict[str, object] | None = None,
    shown: Sequence[int] | None = None,
    ends: Sequence[int] | None = None,
    observations: np.ndarray | None = None,
    separator: str = ".",
    length: int | None = None,
    map_size: int = 1 << 24,
) -> Path:
    """An image store of trifinger_rl_datasets; `length` repeats the images without storing more of them."""
    import lmdb
    import numcodecs

    shots = content.raw.reshape(-1, *content.raw.shape[2:])
    shots = [quadrants(raw) if reorder else raw for raw in shots]
    pictures = [cv2.imencode(codec, pixels)[1].tobytes() for pixels in shots]
    total, chunk = len(pictures) if length is None else length, 4
    folder.mkdir(parents=True)
    codec_of = numcodecs.get_codec(compressor) if compressor else None
    environment = lmdb.open(str(folder), map_size=map_size)
    with environment.begin(write=True) as transaction:

        def put(key: str, data: bytes) -> None:
            transaction.put(key.encode(), codec_of.encode(data) if codec_of and key[-1].isdigit() else data)

        def array(name: str, shape: Sequence[int], chunks: Sequence[int], dtype: str, **more: object) -> None:
            meta = {"zarr_format": 2, "shape": shape, "chunks": chunks, "dtype": dtype, "order": "C"}
            meta |= {"filters": None, "compressor": compressor, "fill_value": 0, **more}
            put(f"{name}/.zarray", json.dumps(meta).encode())

        put(".zgroup", b'{"zarr_format": 2}')
        array("images", [total], [chunk], "|O", filters=[{"id": coding}])
        attributes = {"n_cameras": content.raw.shape[1], "n_channels": 3, "compression": "image"}
        attributes |= {"image_codec": codec[1:], "image_shape": content.raw.shape[2:]}
        attributes["reorder_pixels"] = reorder
        put("images/.zattrs", json.dumps(attributes).encode())
        for start in range(0, total, chunk):
            items = [pictures[(start + k) % len(pictures)] for k in range(min(chunk, total - start))]
            block = struct.pack("<I", len(items)) + b"".join(struct.pack("<I", len(i)) + i for i in items)
            put(f"images/{start // chunk}", block)
        for name, numbers in (("obs_to_image_index", shown), ("episode_ends", ends)):
            if numbers is not None:
                array(name, [len(numbers)], [chunk], "<i8")
                whole = np.pad(np.asarray(numbers, "<i8"), (0, -len(numbers) % chunk))
                for k, block in enumerate(whole.reshape(-1, chunk)):
                    put(f"{name}/{k}", block.tobytes())
        if observations is not None:  # of chunks that fit neither rows nor columns
            named = {} if separator == "." else {"dimension_separator": separator}
            array("observations", observations.shape, [7, 50], "<f4", order="F", fill_value=0.0, **named)
            rows, columns = observations.shape
            whole = np.pad(observations.astype("<f4"), ((0, -rows % 7), (0, -columns % 50)))
            for i, j in np.ndindex(len(whole) // 7, whole.shape[1] // 50):
                block = whole[7 * i : 7 * i + 7, 50 * j : 50 * j + 50]
                put(f"observations/{i}{separator}{j}", block.tobytes("F"))
    environment.close()
    (folder / "lock.mdb").unlink()
    return folder


def write_store_by_zarr(
    folder: Path,
    content: Content,
    *,
    shown: Sequence[int],
    ends: Sequence[int] = (),
    observations: np.ndarray | None = None,
) -> Path:
    """A store as above that zarr itself writes; skips the test where no zarr does."""
    zarr = pytest.importorskip("zarr", reason="zarr: no module zarr")
    if not hasattr(zarr, "LMDBStore"):
        lack("zarr", f"{zarr.__version__} cannot write LMDB stores")
    from numcodecs import VLenBytes

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # later versions warn of its removal
        store = zarr.LMDBStore(str(folder), map_size=1 << 26)
    root = zarr.group(store=store)
    _, cameras, *shape = content.raw.shape
    pictures = [cv2.imencode(".png", raw)[1].tobytes() for raw in content.raw.reshape(-1, *shape)]
    coded = {"dtype": object, "object_codec": VLenBytes()}
    images = root.create_dataset("images", shape=len(pictures), chunks=4, **coded)
    images[:] = np.array(pictures, dtype=object)
    images.attrs.update(n_cameras=cameras, image_shape=shape, reorder_pixels=False, compression="image")
    for name, numbers in (("obs_to_image_index", shown), ("episode_ends", ends)):
        if len(numbers):
            root.create_dataset(name, data=np.asarray(numbers), chunks=4)
    if observations is not None:
        root.create_dataset("observations", data=observations, chunks=(50, 31))
    store.close()
    return folder


def write_picture(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)
