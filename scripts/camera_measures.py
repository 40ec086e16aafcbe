"""Measurements of a camera from one image: blur, overshoot, noise, response, fringes, JPEG blocks.

If an image is, to the bit, the interpolation of an RGGB mosaic, values are read at the mosaic's own sites
only, so that interpolation does not affect blur and fringes.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from synthetic.camera.sensor import RESPONSE_GAMMA, demosaicked, mosaicked
from tracker.conventions import Array, FloatArray, Image

CHANNELS = ("blue", "green", "red")
SITES = (((1, 1),), ((0, 1), (1, 0)), ((0, 0),))
"""Rows and columns modulo 2 at which an RGGB sensor measures blue, green and red."""

LENGTH, REACH = 20.0, 6.0
"""Size of an edge's piece: along it, and to each side [px]; four fifths of it in small images."""

STEP, MISFIT = 30.0, 0.08
"""Smallest step of values across an edge, and largest root mean square residual relative to it."""

_BLOCK = 6
"""Side of the squares in which noise is separated from light [sites]."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A blurred step fitted to a straight piece of an edge in one channel."""

    center: FloatArray
    """(2,) [px]."""
    normal: FloatArray
    """(2,) unit vector towards the brighter side."""
    offset: float
    """Position of the step along the normal, from `center` [px]."""
    sigma: float
    """Standard deviation of its blur, in light [px]; the pixel's own square alone gives 0.29."""
    over: tuple[float, float]
    """Overshoot at 0.7 to 1.8 px from the step, beyond the values further out: how much darker on the dark
    side, how much brighter on the bright side, relative to the step; NaN where values are clipped."""


def is_mosaic(image: Image) -> bool:
    """Return whether the image is the interpolation of its own mosaic; compression destroys this."""
    inner = np.s_[2:-2, 2:-2]  # OpenCV copies values to the border
    return bool(np.array_equal(demosaicked(mosaicked(image))[inner], image[inner]))


def is_raw(image: Image) -> bool:
    """Return whether the mosaic is the sensor's own: small recorded images were mosaicked a second time."""
    return image.shape[0] > 400 and is_mosaic(image)


def pieces(image: Image) -> list[tuple[FloatArray, FloatArray]]:
    """Return centres (2,) and directions (2,) of straight pieces of edges."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (0, 0), 0.8)
    lines = cv2.createLineSegmentDetector().detect(grey)[0]
    length = _scale(image) * LENGTH
    result = []
    for line in np.empty((0, 4)) if lines is None else lines.reshape(-1, 4).astype(np.float64):
        start, along = line[:2], line[2:] - line[:2]
        whole = float(np.linalg.norm(along))
        count = int(whole // length)
        along /= whole
        first = 0.5 * (whole - count * length)
        result += [(start + (first + (k + 0.5) * length) * along, along) for k in range(count)]
    return result


def edges(image: Image, channel: int, most: int = 400) -> Iterator[Edge | None]:
    """Yield each piece of an edge as seen in the channel; None where it shows no clean step."""
    raw = is_raw(image)
    for center, along in pieces(image)[:most]:
        yield _fit(image, channel, raw, center, along)


def _scale(image: Image) -> float:
    return 1.0 if image.shape[0] > 400 else 0.8


def _values(
    image: Image, channel: int, raw: bool, center: FloatArray, along: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return values near an edge with their positions along and across it; None too near the border."""
    length, reach = _scale(image) * LENGTH, _scale(image) * REACH
    half = int(length / 2 + reach + 2)
    i, j = int(center[0]), int(center[1])
    if not (half <= i < image.shape[1] - half and half <= j < image.shape[0] - half):
        return None
    y, x = np.mgrid[j - half : j + half + 1, i - half : i + half + 1]
    s = (x - center[0]) * along[0] + (y - center[1]) * along[1]
    d = -(x - center[0]) * along[1] + (y - center[1]) * along[0]
    kept = (np.abs(s) < length / 2) & (np.abs(d) < reach)
    if raw:
        kept &= np.any([(y % 2 == row) & (x % 2 == column) for row, column in SITES[channel]], axis=0)
    return image[y[kept], x[kept], channel].astype(np.float64), s[kept], d[kept]


def _fit(image: Image, channel: int, raw: bool, center: FloatArray, along: FloatArray) -> Edge | None:
    found = _values(image, channel, raw, center, along)
    if found is None:
        return None
    values, s, d = found
    sides = [values[d < -2.5], values[d > 2.5]]
    low, high = (float(np.median(side)) for side in sides)
    if abs(high - low) < STEP or max(low, high) >= 245:
        return None
    spread = [float(np.median(np.abs(side - np.median(side)))) for side in sides]
    noise = max(2.0, 0.74 * sum(spread))
    first, last = (low / 255) ** RESPONSE_GAMMA, (high / 255) ** RESPONSE_GAMMA

    def model(p: FloatArray) -> FloatArray:
        # Light: a step with a slope on each side; values: clipped at black.
        u = d - p[0] - p[1] * s / 12
        before = p[3] * (1 + p[5] * np.minimum(u, 0) / 6)
        light = before + (p[4] * (1 + p[6] * np.maximum(u, 0) / 6) - p[3]) * ndtr(u / p[2])
        result: FloatArray = 255 * np.clip(light, 1e-5, 1) ** (1 / RESPONSE_GAMMA)
        return result

    scale = max(first, last) / 10
    fit = least_squares(
        lambda p: (model(p) - values) / noise,
        [0, 0, 0.8, first, last, 0, 0],
        bounds=([-3, -2, 0.15, -0.2, -0.2, -0.7, -0.7], [3, 2, 3, 1.2, 1.2, 0.7, 0.7]),
        x_scale=[0.3, 0.3, 0.3, scale, scale, 0.1, 0.1],
        loss="soft_l1",
        max_nfev=50,
    )
    if np.sqrt(np.mean((model(fit.x) - values) ** 2)) > MISFIT * abs(high - low):
        return None
    sign = 1.0 if fit.x[4] > fit.x[3] else -1.0
    u = sign * (d - fit.x[0] - fit.x[1] * s / 12)
    normal = sign * np.array([-along[1], along[0]])
    over = _over(values, u, -1.0, abs(high - low)), _over(values, u, 1.0, abs(high - low))
    return Edge(center, normal, sign * float(fit.x[0]), float(fit.x[2]), over)


def _over(values: FloatArray, u: FloatArray, side: float, step: float) -> float:
    near, far = values[(side * u > 0.7) & (side * u < 1.8)], values[side * u > 2.8]
    if len(near) < 4 or len(far) < 4 or near.min() <= 1 or near.max() >= 250:
        return np.nan
    return side * float(near.mean() - np.median(far)) / step


def fringes(image: Image, channel: int, most: int = 400) -> tuple[FloatArray, FloatArray] | None:
    """Return the shift of a channel's edges from green's, and standard deviations; None: too few edges.

    It consists of the shift (x, y) [px], the growth at half the image's height from its centre [px], and the
    shift towards the bright side [px], which is not a fringe but an effect of the response on unequal blur.
    """
    height, width = image.shape[:2]
    rows, values = [], []
    for green, other in zip(edges(image, 1, most), edges(image, channel, most), strict=True):
        if green is None or other is None or max(green.sigma, other.sigma) > 1.6:
            continue
        radius = (green.center - [(width - 1) / 2, (height - 1) / 2]) / (height / 2)
        rows.append([*green.normal, green.normal @ radius, 1.0])
        values.append(other.offset * (green.normal @ other.normal) - green.offset)
    if len(rows) < 30:
        return None
    lhs, rhs, weights = np.array(rows), np.array(values), np.ones(len(rows))
    for _ in range(10):
        found = np.linalg.lstsq(lhs * weights[:, None], rhs * weights, rcond=None)[0]
        residual = rhs - lhs @ found
        spread = 1.48 * float(np.median(np.abs(residual)))
        weights = 1 / np.sqrt(1 + (residual / (2 * spread)) ** 2)
    inverse = np.linalg.inv((lhs * weights[:, None]).T @ (lhs * weights[:, None]))
    return found, spread * np.sqrt(np.diag(inverse))


def planes(image: Image, channel: int) -> list[FloatArray]:
    """Return the channel without interpolated values: the sites of a mosaic, or all of it."""
    if not is_raw(image):
        return [image[:, :, channel].astype(np.float64)]
    return [image[row::2, column::2, channel].astype(np.float64) for row, column in SITES[channel]]


def _flat(plane: Array) -> tuple[FloatArray, FloatArray]:
    """Return means (N,) and residuals (N, n, n) of even squares: unclipped, with quadratic light."""
    n = _BLOCK
    height, width = (size // n * n for size in plane.shape)
    squares = plane[:height, :width].reshape(height // n, n, width // n, n).swapaxes(1, 2).reshape(-1, n * n)
    y, x = np.indices((n, n)).reshape(2, -1)
    basis, _ = np.linalg.qr(np.column_stack([np.ones(n * n), x, y, x * y, x * x, y * y]).astype(np.float64))
    share = squares @ basis
    residual = squares - share @ basis.T
    noise = np.sqrt((residual**2).sum(axis=1) / (n * n - 6))
    even = np.abs(share[:, 1:]).max(axis=1) / n < noise + 1
    kept = even & (squares.min(axis=1) > 0) & (squares.max(axis=1) < 245)
    return squares[kept].mean(axis=1), residual[kept].reshape(-1, n, n)


def noise_curve(image: Image, channel: int) -> FloatArray:
    """Return rows (level, standard deviation of noise, squares) in bins of 8 levels, robust to texture."""
    flats = [_flat(plane) for plane in planes(image, channel)]
    level = np.concatenate([flat[0] for flat in flats])
    freedom = _BLOCK**2 - 6
    noise = np.sqrt(np.concatenate([(flat[1] ** 2).sum(axis=(1, 2)) for flat in flats]) / freedom)
    rows = []
    for low in range(8, 240, 8):
        own = (level >= low) & (level < low + 8)
        if own.sum() >= 12:
            # The 30th percentile of deviations with 30 degrees of freedom is 8 % below the true one.
            rows.append((level[own].mean(), 1.085 * np.percentile(noise[own], 30), own.sum()))
    return np.array(rows).reshape(-1, 3)


def response_exponent(curve: FloatArray) -> float:
    """Fit the exponent of light = value ** exponent to a curve, with constant and shot noise in light."""
    if len(curve) < 6:
        return np.nan
    level, noise, count = curve.T

    def misfit(p: FloatArray) -> FloatArray:
        light = (level / 255) ** p[0]
        slope = 255 / p[0] * light ** (1 / p[0] - 1)
        variance = slope**2 * (np.exp(p[1]) + np.exp(p[2]) * light) + 1 / 12
        result: FloatArray = (0.5 * np.log(variance) - np.log(noise)) * np.sqrt(np.minimum(count, 100) / 10)
        return result

    bounds = ([0.6, -20, -20], [3, -3, -3])
    return float(least_squares(misfit, [1.8, -10, -9], bounds=bounds, loss="soft_l1").x[0])


def noise_spectrum(image: Image, channel: int) -> FloatArray:
    """Return the shares of noise power in rings of spatial frequency, low to high, of the image as it is."""
    _, residual = _flat(image[:, :, channel].astype(np.float64))
    if len(residual) < 30:
        return np.full(4, np.nan)
    # Leave out textured squares, which noise alone does not explain and which would dominate.
    strength = (residual**2).sum(axis=(1, 2))
    residual = residual[strength < np.percentile(strength, 60)]
    power = np.mean(np.abs(np.fft.fft2(residual)) ** 2, axis=0)
    frequency = np.fft.fftfreq(_BLOCK)
    radius = np.hypot(frequency[:, None], frequency[None, :])
    rings = np.digitize(radius, [0.2, 0.35, 0.5])
    share = np.array([power[rings == ring].sum() for ring in range(4)])
    result: FloatArray = share / share.sum()
    return result


def block_ratio(image: Image) -> float:
    """Return the largest mean step between columns, by column modulo 8, over the median; 1 without blocks."""
    steps = np.abs(np.diff(image[:, :, 1].astype(np.float64), axis=1))
    means = [steps[:, k::8].mean() for k in range(8)]
    return float(max(means) / np.median(means))


def vignetting(image: Image) -> float:
    """Return the relative light loss at half the height from the centre, on grey surfaces; NaN: too few.

    The light on them is assumed linear over the image, so only many images together are informative.
    """
    n = 12
    height, width = (size // n * n for size in image.shape[:2])
    shape = (height // n, n, width // n, n, 3)
    squares = image[:height, :width].reshape(shape).swapaxes(1, 2).reshape(height // n, width // n, n * n, 3)
    mean, spread = squares.mean(axis=2), squares[..., 1].std(axis=2)
    kept = (spread < 4) & (mean.min(axis=-1) > 90) & (squares.max(axis=(2, 3)) < 245)
    kept &= np.ptp(mean, axis=-1) < 30
    if kept.sum() < 100:
        return np.nan
    row, column = np.nonzero(kept)
    x, y = (((k + 0.5) * n - size / 2) / (height / 2) for k, size in ((column, width), (row, height)))
    basis = np.column_stack([np.ones(len(x)), x, y, x * x + y * y])
    light = RESPONSE_GAMMA * np.log(mean[kept][:, 1] / 255)
    weights = np.ones(len(x))
    for _ in range(10):
        found = np.linalg.lstsq(basis * weights[:, None], light * weights, rcond=None)[0]
        residual = light - basis @ found
        weights = 1 / np.sqrt(1 + (residual / (3 * np.median(np.abs(residual)) + 1e-6)) ** 2)
    return float(-found[3])
