"""Linear light of what is seen: reflectance × irradiance, plus highlights. All renderers share it.

Formula: light = reflectance · (ambient · sky + Σ lamps · max(0, n·l) · lit) + gloss · highlights
+ coat · mirrored.
"""

from __future__ import annotations

import numpy as np

from synthetic.render.grain import grain, lattice
from synthetic.render.hits import Hits
from synthetic.render.interface import PinholeView
from synthetic.render.mirror import mirrored
from synthetic.render.reach import sky_slope
from synthetic.render.surfaces import Surfaces
from synthetic.scene import Lighting
from tracker.compiled import compiled
from tracker.conventions import Array


def shade(hits: Hits, view: PinholeView, surfaces: Surfaces, lighting: Lighting, reach: Array) -> Array:
    """Linear BGR light (h, w, 3) float32; black where nothing is hit.

    `reach` (h, w, 1 + lamps) float32 is the share of the sky and of each lamp that gets there; of shape
    (0, 0, 0): all of it.
    """
    color = np.zeros((*hits.body.shape, 3), np.float32)
    if not len(surfaces.gloss):
        return color
    rotation = view.camera_from_world[:3, :3]
    eye = -rotation.T @ view.camera_from_world[:3, 3]
    directions = np.array([lamp.direction for lamp in lighting.lamps], np.float64).reshape(-1, 3)
    lamps = np.array([lamp.color for lamp in lighting.lamps], np.float64).reshape(-1, 3)
    ambient = np.array(lighting.ambient, np.float64)
    body = surfaces.colors, surfaces.world_from_body, surfaces.gloss, surfaces.texture, surfaces.grain_seeds
    angle = view.block / max(view.fx, view.fy)
    _shade(hits, eye, angle, lattice(), *body, ambient, directions, lamps, reach, surfaces.coats, color)
    return color


@compiled
def _shade(
    hits: Hits,
    eye: Array,
    pixel_angle: float,
    lattice: Array,
    reflectance: Array,
    world_from_body: Array,
    gloss: Array,
    texture: Array,
    seeds: Array,
    ambient: Array,
    directions: Array,
    lamps: Array,
    reach: Array,
    coats: Array,
    out: Array,
) -> None:
    bodies, rows, points, normals = hits.body, hits.row, hits.points, hits.normals
    shadows = reach.shape[0] > 0
    lit_by = np.ones(len(directions))
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            body = bodies[j, i]
            if body < 0:
                continue
            px, py, pz = points[j, i, 0], points[j, i, 1], points[j, i, 2]
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
            distance = np.sqrt(vx * vx + vy * vy + vz * vz)
            vx, vy, vz = vx / distance, vy / distance, vz / distance
            share = 1.0
            if texture[body] > 0:
                detail = grain(
                    lattice, world_from_body, body, px, py, pz, seeds[body], distance * pixel_angle
                )
                share = max(1.0 + texture[body] * detail, 0.0)
            sky = sky_slope(nz) * (reach[j, i, 0] if shadows else 1.0)
            row = rows[j, i]
            blue, green, red = (
                reflectance[row, 0] * share,
                reflectance[row, 1] * share,
                reflectance[row, 2] * share,
            )
            b, g, r = blue * ambient[0] * sky, green * ambient[1] * sky, red * ambient[2] * sky
            for k in range(len(directions)):
                lx, ly, lz = directions[k, 0], directions[k, 1], directions[k, 2]
                cosine = nx * lx + ny * ly + nz * lz
                lit = reach[j, i, 1 + k] if shadows else 1.0
                if cosine <= 0 or lit == 0:
                    continue
                shine = 0.0
                if gloss[body] > 0:
                    shine = gloss[body] * _highlight(nx, ny, nz, lx + vx, ly + vy, lz + vz)
                b += lit * lamps[k, 0] * (blue * cosine + shine)
                g += lit * lamps[k, 1] * (green * cosine + shine)
                r += lit * lamps[k, 2] * (red * cosine + shine)
            if coats[row, 0] > 0:
                open_sky = reach[j, i, 0] if shadows else 1.0
                for k in range(len(directions)):
                    lit_by[k] = reach[j, i, 1 + k] if shadows else 1.0
                more = mirrored(
                    nx, ny, nz, vx, vy, vz, coats[row, 1], ambient, open_sky, directions, lamps, lit_by
                )
                b, g, r = (
                    b + coats[row, 0] * more[0],
                    g + coats[row, 0] * more[1],
                    r + coats[row, 0] * more[2],
                )
            out[j, i, 0], out[j, i, 1], out[j, i, 2] = b, g, r


@compiled
def _highlight(nx: float, ny: float, nz: float, hx: float, hy: float, hz: float) -> float:
    """Blinn's highlight with the exponent 32; (hx, hy, hz) lies halfway between lamp and eye."""
    product = nx * hx + ny * hy + nz * hz
    if product <= 0:
        return 0.0
    power = product * product / (hx * hx + hy * hy + hz * hz)
    power *= power
    power *= power
    power *= power
    return power * power
