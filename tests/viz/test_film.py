import numpy as np
import pytest

from tracker.viz import write_film

av = pytest.importorskip("av", reason="video: no module av")


def pictures(count=12, shape=(60, 81)):
    for k in range(count):
        picture = np.full((*shape, 3), 40, np.uint8)
        picture[:, : 5 * k] = (30, 60, 200)
        yield picture


def test_film_holds_its_pictures_in_order(tmp_path):
    path = tmp_path / "film.mp4"
    assert write_film(path, pictures(), 10) == 12
    with av.open(str(path)) as film:
        assert float(film.streams.video[0].average_rate) == pytest.approx(10)
        read = [frame.to_ndarray(format="bgr24") for frame in film.decode(video=0)]
    assert len(read) == 12
    for k, (shown, expected) in enumerate(zip(read, pictures(), strict=True)):
        assert shown.shape == (60, 80, 3)
        assert np.abs(shown.astype(int) - expected[:, :80]).mean() < 6, k


def test_a_broken_off_film_leaves_nothing(tmp_path):
    def breaks():
        yield from pictures(3)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError):
        write_film(tmp_path / "film.mp4", breaks(), 10)
    assert list(tmp_path.iterdir()) == []
