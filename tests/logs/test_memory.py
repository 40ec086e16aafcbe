import gzip
import struct
from pathlib import Path

import pytest

from tests.helpers.log_writers import make_content, native_bytes, write_hdf5, write_store
from tests.helpers.reading import peak_of_reading


def native(path: Path, count: int) -> Path:
    record = native_bytes(make_content(1, size=120))[12:]
    with gzip.open(path, "wb", 1) if path.suffix == ".gz" else path.open("wb") as file:
        file.write(struct.pack("<IQ", 1, count))
        file.writelines([record] * count)  # stamps may repeat but not go back
    return path


def hdf5(path: Path, count: int) -> Path:
    return write_hdf5(path, make_content(count, size=120))


def store(path: Path, count: int) -> Path:
    for module in ("lmdb", "numcodecs"):
        pytest.importorskip(module, reason=f"datasets: no module {module}")
    return write_store(path, make_content(2, size=140), length=3 * count, map_size=1 << 27)


@pytest.mark.parametrize(
    ("write", "suffix", "few", "many"),
    [(native, ".dat", 40, 600), (native, ".gz", 40, 300), (hdf5, ".h5", 20, 120), (store, ".zarr", 20, 200)],
)
def test_memory_does_not_grow_with_the_length(write, suffix, few, many, tmp_path):
    def peak(count: int) -> int:
        return peak_of_reading(write(tmp_path / f"{count}{suffix}", count), count)

    peak(2)
    assert peak(many) < 1.2 * peak(few)
