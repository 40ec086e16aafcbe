from __future__ import annotations

import errno
import os
import resource

import pytest

from tracker.files.hdf5 import Disk
from tracker.files.stores import LmdbFile


def test_what_the_disk_refuses_can_be_read_back_from_memory(tmp_path, rng):
    limits, mirror = resource.getrlimit(resource.RLIMIT_FSIZE), bytearray()
    with Disk(tmp_path / "file") as disk:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        try:
            for size in rng.integers(1, 500, 60).tolist():
                at, data = int(rng.integers(len(mirror) + 1)), rng.bytes(size)
                mirror[at : at + size] = data
                disk.seek(at)
                assert disk.write(data) == size
                back, place = bytearray(700), int(rng.integers(len(mirror)))
                disk.seek(place)
                assert back[: disk.readinto(back)] == mirror[place : place + 700]
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert disk.seek(0, os.SEEK_END) == len(mirror) > 1000
        assert disk.fault.errno == errno.EFBIG


@pytest.mark.parametrize("count", [0, 1, 300])
def test_all_that_an_lmdb_database_holds_is_found(tmp_path, rng, count):
    lmdb = pytest.importorskip("lmdb", reason="datasets: no module lmdb")
    values = {f"images/{k}": rng.bytes(int(rng.integers(0, 6000))) for k in rng.permutation(count)}
    with lmdb.open(str(tmp_path), map_size=1 << 24) as environment:
        for _ in range(2):  # twice, so that pages are freed and used again
            with environment.begin(write=True) as transaction:
                for key, value in values.items():
                    transaction.put(key.encode(), value)
                transaction.delete(b"images/0")
    values.pop("images/0", None)
    store = LmdbFile(tmp_path / "data.mdb")
    assert store.entries == len(values)
    for key, value in values.items():
        assert store.get(key, 1 << 20) == value
    for key in ("", "images/0", "images/00", "zzz"):
        assert store.get(key, 1 << 20) is None
    store.close()
