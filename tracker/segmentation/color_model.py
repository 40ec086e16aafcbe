"""Colour models: the probability of each face colour, and of background, given a pixel's colour.

A model is a grid of 32³ nodes over the normalised blue, green and red. The axes are square-root
companded, because shot noise grows with the square root of the level and because the darkest faces
differ by only a few levels. Dense tables of 64³ cells are interpolated from it, so that a pixel costs
three small look-ups and one large one.
"""

import functools
import io
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tracker.checks import Frozen, described, float_array, of_kind, path_of
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.errors import ColorModelError, message, shown
from tracker.files import found_by, names_in, read_bounded, reading, write_whole, writing
from tracker.objects.labels import COLOR_NAMES

CLASSES = len(COLOR_NAMES)
NODES = 32
CELLS = 64
MORE_LIGHT, SHADE = (1.5, 2.0, 3.0, 4.5), 2.0
"""Factors on the light at which a colour is compared, and log odds that make it another face's in shade; a
body of other colours gains as much where faces are taken to be in shade."""

_SHAPE = (CLASSES, NODES, NODES, NODES)
_LOG_STEP = 1 / 16
_KEYS = ("format", "log_posterior", "normalise")
_MAX_BYTES = 4 << 20
_DATA = Path(__file__).parent / "data"


def compand(levels: Array, size: int) -> FloatArray:
    """Map levels 0…255 to coordinates 0…size-1 on the square-root axis."""
    return np.sqrt(np.clip(levels, 0, 255) / 255.0) * (size - 1)


_ROOTS = compand(np.arange(256), CELLS)


@compiled
def fill_channels(gains, channels):  # type: ignore[no-untyped-def]
    """Fill channels (3, 256): the offset of each channel's levels into the dense tables, for gains (3,)."""
    stride = 1
    for k in range(3):
        root = math.sqrt(gains[k])
        for level in range(256):
            channels[k, level] = stride * int(min(_ROOTS[level] * root, CELLS - 1.0) + 0.5)
        stride *= CELLS


@dataclass(frozen=True, eq=False)
class ColorModel(Frozen):
    """Log posteriors of the classes over colour, and whether images are normalised to grey first.

    Attributes:
        name: name of the model.
        log_posterior: (7, 32, 32, 32) by class, blue, green, red; at most 0, the value of a node's best
            class.
        normalise: whether to scale an image's channels so that its greys become neutral; False: no scaling.

    Raises:
        ColorModelError: a value has the wrong type or shape, or the log posteriors are impossible.
    """

    name: str
    log_posterior: FloatArray
    normalise: bool = True

    def __post_init__(self) -> None:
        what = f"colour model {shown(self.name)}: log posteriors"
        values = float_array(self.log_posterior, _SHAPE, what, ColorModelError)
        if values.max() > 0:
            raise ColorModelError(f"{what}: found {values.max():g}, expected 0 for the best class, else less")
        of_kind(self.normalise, bool, f"colour model {shown(self.name)}: normalise", ColorModelError)
        object.__setattr__(self, "log_posterior", values)

    def __repr__(self) -> str:
        light = "greys normalised" if self.normalise else "images as they are"
        known = [COLOR_NAMES[label] for label in np.unique(self.log_posterior.argmax(axis=0)) if label]
        return f"ColorModel({self.name!r}: {', '.join(known)}; {light})"

    @functools.cached_property
    def _dense(self) -> FloatArray:
        # Like scipy.ndimage.zoom of order 1, whose import would take a fifth of the time to a first pose.
        cells = np.linspace(0, NODES - 1, CELLS)
        weights = np.stack([np.interp(cells, np.arange(NODES), node) for node in np.eye(NODES)], axis=1)
        planes = weights @ (self.log_posterior @ weights.T)  # a third of the time of np.einsum
        dense: FloatArray = weights @ planes.reshape(CLASSES, NODES, -1)
        return dense.reshape(CLASSES, CELLS, CELLS, CELLS)

    @functools.cached_property
    def label_table(self) -> Array:
        """(64³,) uint8: the most likely class of each colour cell, blue fastest."""
        return np.ravel(np.argmax(self._dense, axis=0).astype(np.uint8), "F")

    @functools.cached_property
    def shade_table(self) -> Array:
        """`label_table`, but colours that would clearly be another face's in more light are that face's."""
        plain = self.label_table.reshape((CELLS,) * 3, order="F")
        table = plain.copy()
        for light in MORE_LIGHT:
            lit = np.rint(np.arange(CELLS) * math.sqrt(light)).astype(int)
            lit = lit[lit < CELLS]
            dark, brighter = table[: len(lit), : len(lit), : len(lit)], plain[np.ix_(lit, lit, lit)]
            b, g, r = np.nonzero((dark > 0) & (brighter > 0) & (brighter != dark))
            odds = np.sort(self._dense[:, lit[b], lit[g], lit[r]], axis=0)
            clear = odds[-1] - odds[-2] > SHADE
            cells = b[clear], g[clear], r[clear]
            dark[cells] = brighter[cells]
        return np.ravel(table, "F")

    @functools.cached_property
    def margin_table(self) -> Array:
        """(64³,) uint8: log odds of the best face colour over background in steps of 1/16, 0 if negative."""
        margin = self._dense[1:].max(axis=0) - self._dense[0]
        return np.ravel(np.clip(np.rint(margin / _LOG_STEP), 0, 255).astype(np.uint8), "F")

    def channel_tables(self, gains: Array) -> Array:
        """(3, 256) int32: offset of each channel's levels for `gains`; the sum over channels is the cell."""
        channels = np.empty((3, 256), np.int32)
        fill_channels(np.asarray(gains, dtype=np.float64), channels)
        return channels

    def save(self, path: str | Path) -> None:
        """Write the model atomically to one small file (.npz).

        Raises:
            ColorModelError: it cannot be written.
        """
        best = self.log_posterior.max(axis=0)
        codes = np.clip(np.rint((best - self.log_posterior) / _LOG_STEP), 0, 255).astype(np.uint8)
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer, format=np.int64(1), normalise=np.bool_(self.normalise), log_posterior=codes
        )
        target = path_of(path, "colour model", ColorModelError)
        with writing(ColorModelError, f"colour model {target}"):
            write_whole(target, buffer.getvalue())


def _read(path: Path, name: str) -> ColorModel:
    what = f"colour model {path}"
    with reading(what, ColorModelError):
        content = read_bounded(path, _MAX_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            small = sum(entry.file_size for entry in archive.infolist()) <= _MAX_BYTES
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            arrays = {key: np.asarray(data[key]) for key in _KEYS if key in data} if small else {}
    # For a broken file, zipfile, zlib and NumPy raise errors of many types.
    except Exception as error:
        raise ColorModelError(f"{what}: cannot be read as .npz ({message(error)})") from error
    if not small:
        raise ColorModelError(f"{what}: unpacks to more than {_MAX_BYTES} bytes")
    version = arrays.get("format", np.int64(1))
    if version.shape != () or version.dtype.kind not in "iu" or version != 1:
        raise ColorModelError(f"{what}: format {shown(version.tolist())}; this version reads format 1")
    if missing := {*_KEYS} - {*arrays}:
        raise ColorModelError(f"{what}: found no {sorted(missing)}, expected {sorted(_KEYS)}")
    _, codes, normalise = arrays.values()
    if normalise.shape != () or normalise.dtype != np.bool_:
        raise ColorModelError(f"{what}: normalise: found {shown(normalise.tolist())}, expected one boolean")
    if codes.dtype != np.uint8 or codes.shape != _SHAPE:
        found = described(codes)
        raise ColorModelError(f"{what}: log_posterior: found {found}, expected uint8 of shape {_SHAPE}")
    return ColorModel(name, codes * -_LOG_STEP, bool(normalise))


def color_model_names() -> tuple[str, ...]:
    """Return the names of the colour models in the package."""
    return names_in(_DATA, ".npz")


@functools.lru_cache(maxsize=16)
def _shipped(name: str) -> ColorModel:
    return _read(_DATA / f"{name}.npz", name)


def load_colors(name_or_path: str | Path) -> ColorModel:
    """Load a colour model by its name, or from a file that `tracker colors` wrote.

    Raises ColorModelError if the name is unknown or the file is malformed.
    """
    path = found_by(name_or_path, _DATA, ".npz", "colour model", ColorModelError, others=True)
    return _shipped(path.stem) if path.parent == _DATA else _read(path, path.stem)
