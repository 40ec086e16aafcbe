"""`tracker doctor` on this machine, and on machines that lack something."""

from __future__ import annotations

from importlib import metadata
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from tracker.cli import doctor


def report() -> tuple[int, str]:
    result = CliRunner().invoke(doctor.doctor)
    return result.exit_code, result.output


def line_of(text: str, what: str) -> str:
    return next(line for line in text.splitlines() if line[4:].startswith(f"{what} "))


def test_a_machine_that_has_all_is_well():
    code, text = report()
    assert code == 0, text
    for what in ("tracker", "Python", "numpy", "scipy", "OpenCV", "numba", "h5py", "cache", "speed"):
        assert line_of(text, what).startswith("ok")
    assert "reference work" in line_of(text, "speed")
    for extra in ("plot", "synthetic", "rerun", "video"):
        assert line_of(text, extra)


def test_what_is_missing_has_its_remedy(monkeypatch):
    found = doctor._version
    monkeypatch.setattr(
        doctor, "_version", lambda name: None if name in ("scipy", "pyrender") else found(name)
    )
    monkeypatch.setattr(doctor.ctypes.util, "find_library", lambda name: None)
    code, text = report()
    assert code == 1
    assert line_of(text, "scipy").startswith("!!")
    assert "pip install scipy" in text
    assert line_of(text, "synthetic").startswith("--")
    assert "pip install -e '.[synthetic]'" in text
    assert "libegl1" in text


def test_two_opencvs_are_one_too_many(monkeypatch):
    other = SimpleNamespace(metadata={"Name": "opencv-python"})
    both = [*metadata.distributions(), other]
    monkeypatch.setattr(doctor.metadata, "distributions", lambda: both)
    code, text = report()
    assert code == 1
    assert "2 in one folder" in line_of(text, "OpenCV")
    assert "uninstall opencv-python opencv-python-headless" in text


def test_a_cache_that_cannot_be_written_is_told(monkeypatch):
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    code, text = report()
    assert code == 1
    assert "NUMBA_CACHE_DIR" in text


@pytest.mark.parametrize("requirement", ['zmq>=1; extra == "live"', "zmq>=1 ; extra == 'live'"])
def test_extras_are_read_from_what_is_installed(monkeypatch, requirement):
    monkeypatch.setattr(doctor.metadata, "requires", lambda _: ["numpy", requirement])
    assert doctor._extras() == {"live": ["zmq"]}
