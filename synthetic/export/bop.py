"""Data sets in the layout of the BOP challenge: undistorted images, millimetres, OpenCV's camera axes.

    bop/camera.json, dataset_info.json, models/{models_info.json, obj_000001.ply},
    bop/test/000001/{rgb, mask, mask_visib}_CAMERA/, {scene_camera, scene_gt, scene_gt_info}_CAMERA.json

Images and masks are undistorted with the same camera matrix; mosaics are demosaicked first. Cameras are the
true ones, even if users are given another calibration, and each pose is the one at its image's own
timestamp.
"""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from synthetic.camera.sensor import demosaicked
from synthetic.frames import Frame
from synthetic.world.meshes import box, silhouette
from synthetic.world.platform import DICE, DIE_SIZE
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.files import write_whole
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import load_object
from tracker.processes import uninterrupted

with uninterrupted():  # see meshes
    import trimesh

OBJECT_ID = 1
SCENE_FOLDER = Path("test") / "000001"

_MM = 1000.0

DIE_SIZES = np.full(3, DIE_SIZE)
"""Edge lengths of a die (3,) [m]."""


def write_bop_frame(root: Path, frame: Frame) -> None:
    """Write a frame's undistorted images and masks."""
    scene, objects = root / SCENE_FOLDER, len(frame.objects)
    for c, (camera, image) in enumerate(zip(frame.rig, frame.images, strict=True)):
        colored = demosaicked(image) if image.ndim == 2 else image
        name = f"{frame.index:06d}"
        write_png(scene / f"rgb_{camera.name}" / f"{name}.png", undistorted(colored, camera, cv2.INTER_CUBIC))
        labels = undistorted(frame.labels[c], camera, cv2.INTER_NEAREST)
        for number, state in enumerate(frame.objects_at_stamps[c]):
            # A single object's six labels are its faces; those of dice, which hide each other, their numbers.
            if objects == 1:
                visible, whole = labels > 0, undistorted(frame.alone[c], camera, cv2.INTER_NEAREST) > 0
            else:
                pose = camera.camera_from_world @ so3.transform(state.rotation, state.position)
                visible = labels == number + 1
                whole = visible | silhouette(_projected_corners(camera, DIE_SIZES, pose), labels.shape)
            for kind, mask in (("mask", whole), ("mask_visib", visible)):
                path = scene / f"{kind}_{camera.name}" / f"{name}_{number:06d}.png"
                write_png(path, np.where(mask, np.uint8(255), np.uint8(0)))


def write_png(path: Path, image: Image) -> None:
    """Write an image; OSError if that fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # Level 1 takes a third of the default's time and makes files 10 % larger.
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    path.write_bytes(data.tobytes())


def undistorted(image: Image, camera: Camera, interpolation: int) -> Image:
    """Return the image that the same camera would have taken without distortion."""
    size, straight = (camera.width, camera.height), np.eye(3)
    maps = cv2.initUndistortRectifyMap(
        camera.matrix, camera.distortion, straight, camera.matrix, size, cv2.CV_32FC1
    )
    return np.asarray(cv2.remap(image, *maps, interpolation), dtype=np.uint8)


def finish_bop(
    root: Path, rig: CameraRig, entries: Sequence[dict[str, Any]], object_name: str, *, raw: bool = False
) -> None:
    """Write the JSON files and the model, from the masks and the frames' ground truth, see `Frame.truth`.

    Cameras are those of `rig` unless the truth states others; `raw`: the frames' images are mosaics.
    """
    size = DIE_SIZES if object_name == DICE else load_object(object_name).size
    scene = root / SCENE_FOLDER
    for usual in rig:
        files: dict[str, dict[str, Any]] = {"camera": {}, "gt": {}, "gt_info": {}}
        for entry in entries:
            key, camera_entry = int(entry["frame"]), entry.get("cameras", {}).get(usual.name, {})
            keys = ("matrix", "distortion", "camera_from_world")
            changes: dict[str, Any] = {
                key: np.array(camera_entry[key]) for key in keys if key in camera_entry
            }
            camera, found = dataclasses.replace(usual, **changes), camera_entry.get("object", entry["object"])
            items = found if isinstance(found, list) else [] if found is None else [found]
            poses = [camera.camera_from_world @ _world_from_object(item) for item in items]
            masks = [scene / f"{kind}_{camera.name}" / f"{key:06d}" for kind in ("mask", "mask_visib")]
            files["camera"][str(key)] = {"cam_K": camera.matrix.ravel().tolist(), "depth_scale": 1.0} | _pose(
                camera.camera_from_world, "w2c"
            )
            files["gt"][str(key)] = [{"obj_id": OBJECT_ID} | _pose(pose, "m2c") for pose in poses]
            files["gt_info"][str(key)] = [
                _seen(
                    _projected_corners(camera, size, pose),
                    *(_read_mask(mask.with_name(f"{mask.name}_{n:06d}.png")) for mask in masks),
                )
                for n, pose in enumerate(poses)
            ]
        for name, content in files.items():
            _write_json(scene / f"scene_{name}_{usual.name}.json", content)
    _write_model(root / "models", size, object_name)
    (fx, _, cx), (_, fy, cy) = rig[0].matrix[:2].tolist()
    lens = {"cx": cx, "cy": cy, "depth_scale": 1.0, "fx": fx, "fy": fy}
    _write_json(root / "camera.json", lens | {"height": rig[0].height, "width": rig[0].width})
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


def _pose(transform: FloatArray, kind: str) -> dict[str, list[float]]:
    rotation, shift = transform[:3, :3].ravel(), _MM * transform[:3, 3]
    return {f"cam_R_{kind}": rotation.tolist(), f"cam_t_{kind}": shift.tolist()}


def _world_from_object(item: dict[str, Any]) -> FloatArray:
    # Converted by another package instead of the tracker's own code, as an independent check.
    x, y, z, w = item["orientation_xyzw"]
    result: FloatArray = trimesh.transformations.quaternion_matrix([w, x, y, z])  # type: ignore[no-untyped-call]
    result[:3, 3] = item["position"]
    return result


def _read_mask(path: Path) -> Array:
    mask = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    return np.asarray(mask) > 0


def _seen(points: FloatArray, alone: Array, visible: Array) -> dict[str, Any]:
    """Return an object's entries from its projected corners (8, 2) [px] and its two masks.

    As the layout requires, the whole counts pixels beyond the image, and an empty box is all -1.
    """
    left, top, width, height = cv2.boundingRect(visible.astype(np.uint8))
    low, high = (np.rint(end).astype(int) for end in (points.min(axis=0), points.max(axis=0)))
    sides = high - low + 1
    shown, count = int(alone.sum()), int(visible.sum())
    outline = silhouette(points - low, tuple(sides[::-1]))
    rows, columns = (slice(max(-a, 0), max(b - a, 0)) for a, b in zip(low[::-1], alone.shape, strict=True))
    whole = shown + int(outline.sum() - outline[rows, columns].sum())
    return {
        "bbox_obj": [*low.tolist(), *sides.tolist()],
        "bbox_visib": [left, top, width, height] if count else [-1] * 4,
        "px_count_all": whole,
        "px_count_valid": shown,
        "px_count_visib": count,
        "visib_fract": count / whole if whole else 0.0,
    }


def _projected_corners(camera: Camera, size: FloatArray, camera_from_object: FloatArray) -> FloatArray:
    """Return the projected corners (8, 2) [px] without distortion."""
    vector, _ = cv2.Rodrigues(camera_from_object[:3, :3])
    points, _ = cv2.projectPoints(
        corners(size), vector, camera_from_object[:3, 3], camera.matrix, np.zeros(5)
    )
    return np.asarray(points[:, 0])


def _write_model(folder: Path, size: FloatArray, object_name: str) -> None:
    edges = _MM * size
    info: dict[str, Any] = {"diameter": float(np.linalg.norm(edges))}
    for axis, edge in zip("xyz", edges.tolist(), strict=True):
        info[f"min_{axis}"], info[f"size_{axis}"] = -edge / 2, edge
    _write_json(folder / "models_info.json", {str(OBJECT_ID): info})
    labels = np.full(6, 3) if object_name == DICE else load_object(object_name).face_labels
    mesh = box(edges)
    solid = trimesh.Trimesh(
        mesh.vertices,
        mesh.triangles,
        vertex_colors=np.repeat(DISPLAY_COLORS_BGR[labels][:, ::-1], 4, axis=0),
        process=False,
    )
    write_whole(folder / "obj_000001.ply", trimesh.exchange.ply.export_ply(solid, encoding="ascii"))


def _write_json(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps(content, indent=1) + "\n")
