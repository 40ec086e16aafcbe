"""Data sets in the layout of the BOP challenge: undistorted pictures, millimetres, OpenCV's camera axes.

    bop/camera.json, dataset_info.json, models/{models_info.json, obj_000001.ply},
    bop/test/000001/{rgb, mask, mask_visib}_CAMERA/, {scene_camera, scene_gt, scene_gt_info}_CAMERA.json

Pictures are the distorted ones, undistorted with the same camera matrix, mosaics after they were
demosaicked; masks come from the renderer. Cameras are stated as they truly are, also where the calibration
that is given to users is another, and each pose is that of its picture's own moment.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from synthetic.camera.sensor import demosaicked
from synthetic.frames import Frame
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import load_object

OBJECT_ID = 1
SCENE_FOLDER = Path("test") / "000001"
DICE, DIE_SIZE = "dice", 0.022

_MM = 1000.0


def write_bop_frame(root: Path, frame: Frame) -> None:
    """Write the undistorted pictures and the masks of a frame that was made with `pinhole`."""
    scene = root / SCENE_FOLDER
    for camera, image, (labels, alone) in zip(frame.rig, frame.images, frame.pinhole_labels, strict=True):
        folders = {kind: scene / f"{kind}_{camera.name}" for kind in ("rgb", "mask", "mask_visib")}
        for folder in folders.values():
            folder.mkdir(parents=True, exist_ok=True)
        colored = demosaicked(image) if image.ndim == 2 else image
        _write(folders["rgb"] / f"{frame.index:06d}.png", undistorted(colored, camera))
        for number in range(len(frame.objects)):
            name = f"{frame.index:06d}_{number:06d}.png"
            _write(folders["mask"] / name, _mask(alone, number, len(frame.objects)))
            _write(folders["mask_visib"] / name, _mask(labels, number, len(frame.objects)))


def undistorted(image: Image, camera: Camera) -> Image:
    """The picture that the camera of the same matrix without distortion would have taken."""
    size = (camera.width, camera.height)
    straight = np.eye(3)
    maps = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, straight, camera.matrix, size, cv2.CV_32FC1
    )
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_CUBIC), dtype=np.uint8)


def finish_bop(
    root: Path, rig: CameraRig, entries: Sequence[dict[str, Any]], object_name: str, *, raw: bool = False
) -> None:
    """Write the JSON files and the model, from the truth of all frames and the masks.

    Args:
        root: the layout's folder.
        rig: the cameras, where a frame's truth does not say what they are.
        entries: the frames' truth, see `Frame.truth`.
        object_name: what lies there.
        raw: whether the frames' pictures are mosaics.
    """
    size = np.full(3, DIE_SIZE) if object_name == DICE else load_object(object_name).size
    for usual in rig:
        poses: dict[str, Any] = {}
        infos: dict[str, Any] = {}
        cameras: dict[str, Any] = {}
        for entry in entries:
            key = str(int(entry["frame"]))
            camera, objects = _true_camera(entry, usual), _objects(entry, usual.name)
            poses[key] = [_in_camera(item, camera) for item in objects]
            infos[key] = [
                _info(root, camera, int(entry["frame"]), n, size, objects) for n in range(len(objects))
            ]
            cameras[key] = {
                "cam_K": camera.matrix.ravel().tolist(),
                "depth_scale": 1.0,
                "cam_R_w2c": camera.camera_from_world[:3, :3].ravel().tolist(),
                "cam_t_w2c": (_MM * camera.camera_from_world[:3, 3]).tolist(),
            }
        for name, content in (("camera", cameras), ("gt", poses), ("gt_info", infos)):
            _write_json(root / SCENE_FOLDER / f"scene_{name}_{usual.name}.json", content)
    _write_models(root / "models", size, object_name)
    first = rig[0]
    _write_json(
        root / "camera.json",
        {
            "cx": first.matrix[0, 2],
            "cy": first.matrix[1, 2],
            "depth_scale": 1.0,
            "fx": first.matrix[0, 0],
            "fy": first.matrix[1, 1],
            "height": first.height,
            "width": first.width,
        },
    )
    about = {
        "name": f"trifinger_{object_name}",
        "cameras": list(rig.names),
        "objects": {str(OBJECT_ID): object_name},
        "synthetic": True,
        "distortion": "removed",
        "mosaic": "removed" if raw else "none",
        "calibration": "true; where users are given another one it is in the folder of its frame",
        "moments": "each pose is that of its picture's moment; ground_truth.json has the stamps",
        "files_of_a_camera": "test/000001/*_CAMERA and scene_*_CAMERA.json",
    }
    _write_json(root / "dataset_info.json", about)


def _of_camera(entry: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = entry.get("cameras", {}).get(name, {})
    return found


def _true_camera(entry: dict[str, Any], usual: Camera) -> Camera:
    """A frame's camera, told where it is not the usual one."""
    told = _of_camera(entry, usual.name)
    keys = ("matrix", "distortion", "camera_from_world")
    changes: dict[str, Any] = {key: np.array(told[key]) for key in keys if key in told}
    return dataclasses.replace(usual, **changes)


def _objects(entry: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """What is there at the moment of a camera's picture."""
    found = _of_camera(entry, name).get("object", entry["object"])
    return found if isinstance(found, list) else [] if found is None else [found]


def _in_camera(item: dict[str, Any], camera: Camera) -> dict[str, Any]:
    transform = camera.camera_from_world @ _world_from_object(item)
    return {
        "obj_id": OBJECT_ID,
        "cam_R_m2c": transform[:3, :3].ravel().tolist(),
        "cam_t_m2c": (_MM * transform[:3, 3]).tolist(),
    }


def _world_from_object(item: dict[str, Any]) -> FloatArray:
    # Written out, so that the exported poses do not share the tracker's conversion.
    x, y, z, w = np.asarray(item["orientation_xyzw"]) / np.linalg.norm(item["orientation_xyzw"])
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    result[:3, 3] = item["position"]
    return result


def _info(
    root: Path, camera: Camera, frame: int, number: int, size: FloatArray, objects: list[dict[str, Any]]
) -> dict[str, Any]:
    name = f"{frame:06d}_{number:06d}.png"
    masks: list[Array] = []
    for kind in ("mask", "mask_visib"):
        path = root / SCENE_FOLDER / f"{kind}_{camera.name}" / name
        mask = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
        masks.append(np.asarray(mask) > 0)
    whole, visible = (int(mask.sum()) for mask in masks)
    return {
        "bbox_obj": _amodal_box(camera, size, objects[number]),
        "bbox_visib": _box(masks[1]),
        "px_count_all": whole,
        "px_count_valid": whole,
        "px_count_visib": visible,
        "visib_fract": visible / whole if whole else 0.0,
    }


def _amodal_box(camera: Camera, size: FloatArray, item: dict[str, Any]) -> list[int]:
    """Left, top, width and height [px] of the projected outline, which may leave the image."""
    transform = camera.camera_from_world @ _world_from_object(item)
    vector, _ = cv2.Rodrigues(transform[:3, :3])
    points, _ = cv2.projectPoints(corners(size), vector, transform[:3, 3], camera.matrix, np.zeros(5))
    low, high = np.rint(points.min(axis=(0, 1))), np.rint(points.max(axis=(0, 1)))
    return [int(low[0]), int(low[1]), int(high[0] - low[0] + 1), int(high[1] - low[1] + 1)]


def _box(mask: Array) -> list[int]:
    """Left, top, width and height [px]; -1 where nothing is seen, as the layout wants it."""
    if not mask.any():
        return [-1, -1, -1, -1]
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return [
        int(columns[0]),
        int(rows[0]),
        int(columns[-1] - columns[0] + 1),
        int(rows[-1] - rows[0] + 1),
    ]


def _mask(labels: Image, number: int, objects: int) -> Image:
    # The six labels of a single object are its faces, those of dice their numbers.
    chosen = labels > 0 if objects == 1 else labels == number + 1
    return np.where(chosen, np.uint8(255), np.uint8(0))


def _write_models(folder: Path, size: FloatArray, object_name: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    edges = (_MM * size).tolist()
    info: dict[str, Any] = {"diameter": float(_MM * np.linalg.norm(size))}
    for axis, edge in zip("xyz", edges, strict=True):
        info[f"min_{axis}"], info[f"size_{axis}"] = -edge / 2, edge
    _write_json(folder / "models_info.json", {str(OBJECT_ID): info})
    labels = np.full(6, 3) if object_name == DICE else load_object(object_name).face_labels
    lines = ["ply", "format ascii 1.0", "element vertex 24"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {color}" for color in ("red", "green", "blue")]
    lines += ["element face 12", "property list uchar int vertex_indices", "end_header"]
    points = _MM * corners(size)
    for face, label in zip(FACE_CORNERS, labels, strict=True):
        blue, green, red = DISPLAY_COLORS_BGR[int(label)].tolist()
        lines += [f"{x:g} {y:g} {z:g} {red} {green} {blue}" for x, y, z in points[face]]
    for face in range(6):
        lines += [
            f"3 {4 * face} {4 * face + 1} {4 * face + 2}",
            f"3 {4 * face} {4 * face + 2} {4 * face + 3}",
        ]
    _replace(folder / "obj_000001.ply", ("\n".join(lines) + "\n").encode())


def _write(path: Path, image: Image) -> None:
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    _replace(path, data.tobytes())


def _write_json(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _replace(path, (json.dumps(content, indent=1) + "\n").encode())


def _replace(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_bytes(content)
    os.replace(temporary, path)
