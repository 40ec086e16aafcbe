"""Linear light of visible surfaces: reflectance × irradiance, highlights, and light between near surfaces.

light = reflectance · (ambient · sky + Σ lamps · max(0, n·l) · lit) + gloss · highlights + coat · mirrored.

A patch of area A with light E (reflectance × irradiance) gives a point at distance d the irradiance
E cos θ cos θ' A / (π d² + A): exact far away and at most E close by. Occlusion is ignored.
"""

from functools import lru_cache

import numpy as np

from synthetic.render.hits import Hits, turned_back
from synthetic.render.raster import PinholeView
from synthetic.render.shadows import sky_slope
from synthetic.render.surfaces import Surfaces
from synthetic.scene import Lighting, Patches, PlatformScene
from tracker.compiled import compiled
from tracker.conventions import Array

_SIZES_M = (0.0011, 0.006, 0.03)
"""Sizes of grain, scratches and blotches [m]."""

_CELLS = 32
"""Period of the noise along each axis [cells]; each size therefore repeats at other distances."""

_NORMAL_REFLECTANCE = 0.04
"""Reflectance at normal incidence of a clear coat of refractive index 1.5."""

_LAMP_HALF_WIDTH = 0.17
"""Angular half width of mirrored lamps [rad]: panels and tubes, wider than the disks that cast shadows."""

_TABLE, _WALL, _CEILING = 0.04, 0.25, 1.1
"""Radiance of mirrored surroundings, relative to the ambient light."""

_WALL_TOP = 0.45
"""Sine of the elevation of the wall's top around the arena."""

Vector = tuple[float, float, float]
"""A vector in the world, or blue, green and red."""

Light = tuple[Array, Array, Array]
"""Ambient light (3,), directions to the lamps (N, 3) and their colours (N, 3)."""


def shade(hits: Hits, view: PinholeView, surfaces: Surfaces, lighting: Lighting, reach: Array) -> Array:
    """Return linear BGR light (h, w, 3) float32; black where nothing is hit.

    `reach` (h, w, 1 + lamps) float32 is the unoccluded share of the sky and of each lamp.
    """
    color = np.zeros((*hits.body.shape, 3), np.float32)
    if not len(surfaces.gloss):
        return color
    rotation = view.camera_from_world[:3, :3]
    eye = -rotation.T @ view.camera_from_world[:3, 3]
    light = (
        np.array(lighting.ambient, np.float64),
        np.array([lamp.direction for lamp in lighting.lamps], np.float64).reshape(-1, 3),
        np.array([lamp.color for lamp in lighting.lamps], np.float64).reshape(-1, 3),
    )
    angle = view.block / max(view.fx, view.fy)
    _shade(hits, eye, angle, _lattice(), surfaces, light, reach, color)
    return color


@compiled
def _shade(
    hits: Hits,
    eye: Array,
    pixel_angle: float,
    cells: Array,
    surfaces: Surfaces,
    light: Light,
    reach: Array,
    out: Array,
) -> None:
    ambient, directions, lamps = light
    bodies, rows, points, normals = hits.body, hits.row, hits.points, hits.normals
    reflectance, gloss, texture, coats = surfaces.colors, surfaces.gloss, surfaces.texture, surfaces.coats
    seeds, poses = surfaces.grain_seeds, surfaces.world_from_body
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
                detail = _grain(cells, poses, body, (px, py, pz), seeds[body], distance * pixel_angle)
                share = max(1.0 + texture[body] * detail, 0.0)
            sky = sky_slope(nz) * reach[j, i, 0]
            row = rows[j, i]
            blue, green = reflectance[row, 0] * share, reflectance[row, 1] * share
            red = reflectance[row, 2] * share
            b, g, r = blue * ambient[0] * sky, green * ambient[1] * sky, red * ambient[2] * sky
            for k in range(len(directions)):
                lx, ly, lz = directions[k, 0], directions[k, 1], directions[k, 2]
                cosine = nx * lx + ny * ly + nz * lz
                lit = reach[j, i, 1 + k]
                if cosine <= 0 or lit == 0:
                    continue
                shine = 0.0
                if gloss[body] > 0:
                    shine = gloss[body] * _highlight(nx, ny, nz, lx + vx, ly + vy, lz + vz)
                b += lit * lamps[k, 0] * (blue * cosine + shine)
                g += lit * lamps[k, 1] * (green * cosine + shine)
                r += lit * lamps[k, 2] * (red * cosine + shine)
            if coats[row, 0] > 0:
                coat, blur = coats[row, 0], coats[row, 1]
                more = _mirrored((nx, ny, nz), (vx, vy, vz), blur, light, reach[j, i])
                b, g, r = b + coat * more[0], g + coat * more[1], r + coat * more[2]
            out[j, i, 0], out[j, i, 1], out[j, i, 2] = b, g, r


@compiled
def _highlight(nx: float, ny: float, nz: float, hx: float, hy: float, hz: float) -> float:
    """Return Blinn's highlight with exponent 32; (hx, hy, hz) is the unnormalised half vector."""
    product = nx * hx + ny * hy + nz * hz
    if product <= 0:
        return 0.0
    power = product * product / (hx * hx + hy * hy + hz * hz)
    power *= power
    power *= power
    power *= power
    return power * power


@lru_cache(maxsize=1)
def _lattice() -> Array:
    """Return random values (32, 32, 32) float32, scaled so that the sum of all sizes has deviation ~1."""
    values = np.random.default_rng(0).uniform(-1.0, 1.0, (_CELLS,) * 3)
    scaled: Array = values * np.sqrt(3.0 / (len(_SIZES_M) * (2.0 / 3.0) ** 3))
    return scaled.astype(np.float32)


@compiled
def _grain(
    cells: Array, world_from_body: Array, body: int, point: Vector, seed: int, footprint: float
) -> float:
    """Return noise at a point of the world, without sizes that a pixel of `footprint` [m] cannot resolve."""
    pose = world_from_body
    away = point[0] - pose[body, 0, 3], point[1] - pose[body, 1, 3], point[2] - pose[body, 2, 3]
    x, y, z = turned_back(pose, body, away)
    # Shift by fractions of a cell that depend on the body, so that no face lies in a lattice plane.
    x += 1e-3 * ((seed & 255) + 0.37)
    y += 1e-3 * (((seed >> 8) & 255) + 0.71)
    z += 1e-3 * (((seed >> 16) & 255) + 0.13)
    total = 0.0
    for octave in range(len(_SIZES_M)):
        size = _SIZES_M[octave]
        if size > footprint:
            total += _noise(cells, x / size, y / size, z / size)
    return total


@compiled
def _noise(cells: Array, x: float, y: float, z: float) -> float:
    """Interpolate smoothly between the random values at integer coordinates."""
    floor_x, floor_y, floor_z = np.floor(x), np.floor(y), np.floor(z)
    u, v, w = _smooth(x - floor_x), _smooth(y - floor_y), _smooth(z - floor_z)
    i, j, k = int(floor_x) & (_CELLS - 1), int(floor_y) & (_CELLS - 1), int(floor_z) & (_CELLS - 1)
    i1, j1, k1 = (i + 1) & (_CELLS - 1), (j + 1) & (_CELLS - 1), (k + 1) & (_CELLS - 1)
    near = (1 - w) * cells[i, j, k] + w * cells[i, j, k1]
    left = (1 - v) * near + v * ((1 - w) * cells[i, j1, k] + w * cells[i, j1, k1])
    far = (1 - w) * cells[i1, j, k] + w * cells[i1, j, k1]
    right = (1 - v) * far + v * ((1 - w) * cells[i1, j1, k] + w * cells[i1, j1, k1])
    return float((1 - u) * left + u * right)


@compiled
def _smooth(share: float) -> float:
    """Return a step from 0 to 1 with level ends; a linear one would show the lattice's planes."""
    return share * share * (3.0 - 2.0 * share)


@compiled
def _mirrored(normal: Vector, view: Vector, blur: float, light: Light, reach: Array) -> Vector:
    """Return the light (blue, green, red) that a full clear coat reflects towards the unit vector `view`.

    Uses Schlick's approximation of Fresnel reflectance; a lamp is a Gaussian of lamp width and blur combined.
    """
    (nx, ny, nz), (vx, vy, vz) = normal, view
    ambient, directions, lamps = light
    cosine = max(nx * vx + ny * vy + nz * vz, 0.0)
    grazing = (1.0 - cosine) * (1.0 - cosine)
    fresnel = _NORMAL_REFLECTANCE + (1.0 - _NORMAL_REFLECTANCE) * grazing * grazing * (1.0 - cosine)
    rx, ry, rz = 2 * cosine * nx - vx, 2 * cosine * ny - vy, 2 * cosine * nz - vz
    soft = blur + 0.05
    above = _step(rz / soft)
    high = _step((rz - _WALL_TOP) / soft)
    around = _TABLE + above * (_WALL - _TABLE) + high * reach[0] * (_CEILING - _WALL)
    b, g, r = ambient[0] * around, ambient[1] * around, ambient[2] * around
    width = _LAMP_HALF_WIDTH * _LAMP_HALF_WIDTH + blur * blur
    for k in range(len(directions)):
        miss = 1.0 - (rx * directions[k, 0] + ry * directions[k, 1] + rz * directions[k, 2])
        share = reach[1 + k] * np.exp(-2.0 * miss / width) / width
        b, g, r = b + share * lamps[k, 0], g + share * lamps[k, 1], r + share * lamps[k, 2]
    return fresnel * b, fresnel * g, fresnel * r


@compiled
def _step(x: float) -> float:
    """Return a smooth step from 0 at -1 to 1 at 1."""
    x = min(max(0.5 + 0.5 * x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


_REACH_M = 0.06
"""Distance from the outermost patch beyond which the patches' light is ignored [m]."""


def add_bounced(color: Array, scene: PlatformScene, patches: Patches, hits: Hits, surfaces: Surfaces) -> None:
    """Add to `color` (h, w, 3) the light of the scene's patches on bodies other than their own."""
    numbers = {body.name: number for number, body in enumerate(scene.bodies)}
    owners = np.array([numbers[name] for name in patches.owners.tolist()], dtype=np.int64)
    middle = patches.places.mean(axis=0)
    reach = float(np.linalg.norm(patches.places - middle, axis=1).max()) + _REACH_M
    lights = Patches(*map(np.ascontiguousarray, patches._replace(owners=owners)))
    _add(color, hits, surfaces.colors, middle, reach * reach, lights)


@compiled
def _add(color: Array, hits: Hits, reflectance: Array, middle: Array, reach2: float, lights: Patches) -> None:
    body, row, points, normals = hits.body, hits.row, hits.points, hits.normals
    places, facing, areas, light, owners = lights
    for j in range(body.shape[0]):
        for i in range(body.shape[1]):
            if body[j, i] < 0:
                continue
            px, py, pz = points[j, i, 0], points[j, i, 1], points[j, i, 2]
            if (px - middle[0]) ** 2 + (py - middle[1]) ** 2 + (pz - middle[2]) ** 2 > reach2:
                continue
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            blue, green, red = 0.0, 0.0, 0.0
            for k in range(len(areas)):
                if owners[k] == body[j, i]:
                    continue
                dx, dy, dz = places[k, 0] - px, places[k, 1] - py, places[k, 2] - pz
                here = nx * dx + ny * dy + nz * dz
                if here <= 0:
                    continue
                square = dx * dx + dy * dy + dz * dz
                there = -(facing[k, 0] * dx + facing[k, 1] * dy + facing[k, 2] * dz)
                if facing[k, 0] == 0 and facing[k, 1] == 0 and facing[k, 2] == 0:
                    there = np.sqrt(square)  # a zero normal marks a round patch, which faces everything
                if there <= 0:
                    continue
                share = here * there / square * areas[k] / (np.pi * square + areas[k])
                blue += share * light[k, 0]
                green += share * light[k, 1]
                red += share * light[k, 2]
            color[j, i, 0] += reflectance[row[j, i], 0] * blue
            color[j, i, 1] += reflectance[row[j, i], 1] * green
            color[j, i, 2] += reflectance[row[j, i], 2] * red
