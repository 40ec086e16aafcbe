from __future__ import annotations

import errno
import os
import resource

from tracker.files.hdf5_disk import Disk


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
