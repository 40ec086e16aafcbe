"""What a policy sees in a simulator: poses with the tracker's errors, as late as on the platform."""

from collections import deque

import numpy as np

import tracker

COUNT, PERIOD, STEP = 1000, 0.1, 0.02  # environments; between images, and between actions [s]

rng = np.random.default_rng(1)
errors = tracker.noise.NoiseModel.load("platform").start(rng, COUNT)
position = np.column_stack([rng.uniform(-0.1, 0.1, (COUNT, 2)), np.full(COUNT, 0.0325)])
orientation = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))
visible = rng.uniform(0.5, 1.0, COUNT)  # share of the object's pixels that no finger hides
known = np.full((COUNT, 3), np.nan)
coming: deque[tuple[float, tracker.noise.Seen]] = deque()
for step in range(100):
    now = step * STEP
    position[:, 0] += 0.05 * STEP  # your physics
    if step % round(PERIOD / STEP) == 0:
        coming.append((now, errors.step(position, orientation, visible, PERIOD)))
    for taken, seen in coming:  # a delay may be longer than a period
        arrived = seen.found & (taken + seen.delay <= now)
        known[arrived] = seen.position[arrived]  # what the policy may use
    while len(coming) > 1 and (coming[0][0] + coming[0][1].delay <= now).all():
        coming.popleft()
    ended = rng.random(COUNT) < 0.001
    errors.reset(ended)
    known[ended] = np.nan
    for _, seen in coming:
        seen.found[ended] = False  # what is on its way belongs to the previous episode
off = 1e3 * np.linalg.norm(known - position, axis=1)
print(f"{100 * np.isfinite(off).mean():.0f} % known, median error {np.nanmedian(off):.1f} mm")
