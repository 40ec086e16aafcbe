"""Light as on the real platforms: lamps above the arena, and light from everywhere."""

from __future__ import annotations

import numpy as np

from synthetic.scene import Lamp, Lighting


def random_lighting(rng: np.random.Generator) -> Lighting:
    """Light from everywhere and one to three lamps: about 1 on a surface that faces up."""
    total = np.exp(rng.normal(0.0, 0.08)) * rng.normal(1.0, 0.015, 3)
    ambient_share = rng.uniform(0.5, 0.85)
    count = int(rng.integers(1, 4))
    shares = rng.dirichlet(np.full(count, 2.0)) * (1 - ambient_share)
    lamps = []
    for share in shares:
        azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(48, 88))
        level = np.cos(elevation)
        direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        # A lamp's share is what it gives to the table, except that a low lamp would dazzle the sides.
        color = total * share / max(direction[2], 0.75) * rng.normal(1.0, 0.02, 3)
        lamps.append(Lamp(direction, color))
    return Lighting(total * ambient_share, tuple(lamps))
