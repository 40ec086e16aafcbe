from __future__ import annotations

import pytest

from tracker.files.lmdb import LmdbFile

lmdb = pytest.importorskip("lmdb", reason="datasets: no module lmdb")


@pytest.mark.parametrize("count", [0, 1, 300])
def test_all_that_an_lmdb_database_holds_is_found(tmp_path, rng, count):
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
