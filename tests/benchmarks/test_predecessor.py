from __future__ import annotations

import cv2
import numpy as np

import tracker
from benchmarks import metrics, predecessor
from synthetic.raycast import render
from synthetic.sensor import Sensor
from synthetic.simple import random_scene
from synthetic.simple_rig import default_cameras
from tracker.geometry import so3

CUBE = tracker.load_object("cube_v2")


def clean_cube(seed):
    rng = np.random.default_rng(seed)
    cameras = default_cameras()
    return cameras, render(random_scene(CUBE, rng, occlusion=0.0), cameras, CUBE, Sensor.clean(), rng)


def test_a_clean_cube_is_found_coarsely_and_always_the_same():
    colors = tracker.load_colors("cube_v2")
    right = 0
    for seed in range(3):
        cameras, made = clean_cube(seed)
        position, rotation = predecessor.find(CUBE, cameras, made.images, colors, seed)
        again = predecessor.find(CUBE, cameras, made.images, colors, seed)
        assert np.array_equal(position, again[0])
        right += (
            metrics.position_error(made.position, position) < 5e-3
            and metrics.rotation_error(made.rotation, rotation) < 0.12
        )
    assert right >= 2


def test_where_no_colour_is_nothing_is_found():
    images = [np.full((270, 270, 3), 90, np.uint8)] * 3
    assert predecessor.find(CUBE, default_cameras(), images, tracker.load_colors("cube_v2"), 0) is None


def test_the_true_pose_costs_little_and_others_more(rng):
    cameras, made = clean_cube(1)
    colors = tracker.load_colors("cube_v2")
    views = predecessor._views(CUBE, cameras, made.images, colors, rng)
    assert sum(len(view.pixels) for view in views) == predecessor.PIXELS
    true = np.concatenate([made.position, so3.log(made.rotation)])
    others = true + rng.normal(0, 1, (50, 6)) * [0.02, 0.02, 0.02, 0.5, 0.5, 0.5]
    costs = predecessor.cost(np.vstack([true, others]), views, CUBE.size)
    assert costs[0] < 0.2
    assert costs[0] == costs.min()


def test_distance_outside_a_polygon_is_opencvs(rng):
    for _ in range(20):
        hull = cv2.convexHull(rng.uniform(0, 100, (4, 2)).astype(np.float32))[:, 0]
        if len(hull) < 4:
            continue
        points = rng.uniform(-50, 150, (60, 2))
        expected = [max(0.0, -cv2.pointPolygonTest(hull, (float(x), float(y)), True)) for x, y in points]
        for polygon in (hull, hull[::-1]):
            polygons = np.tile(polygon.astype(float), (1, len(points), 1, 1))
            found = predecessor.outside_distance(polygons, points)
            np.testing.assert_allclose(found[0], expected, atol=1e-3)
