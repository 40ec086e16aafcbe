import sys
from importlib import metadata
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from tracker import warm_up
from tracker.cli import doctor


def report() -> tuple[int, str]:
    result = CliRunner().invoke(doctor.doctor)
    return result.exit_code, result.output


def line_of(text: str, what: str) -> str:
    return next(line for line in text.splitlines() if line[4:].startswith(f"{what} "))


def test_a_machine_that_has_all_is_well():
    code, text = report()
    assert code == 0, text
    libraries = ("numpy", "scipy", "OpenCV", "numba", "h5py", "Pillow")
    for what in ("tracker", "Python", *libraries, "cache", "speed"):
        assert line_of(text, what).startswith("ok")
    assert "reference work" in line_of(text, "speed")
    for extra in ("plot", "synthetic", "rerun", "video"):
        assert line_of(text, extra)


def test_what_is_missing_has_its_remedy(monkeypatch):
    found = doctor._version
    gone = ("scipy", "pyrender")
    monkeypatch.setattr(doctor, "_version", lambda name: None if name in gone else found(name))
    monkeypatch.setattr(doctor, "_fault_of_module", lambda name: "gone" if name == "scipy" else None)
    code, text = report()
    assert code == 1
    assert "speed" not in text  # without SciPy nothing is there to be looked at
    assert line_of(text, "scipy").startswith("!!")
    assert "pip install scipy" in text
    assert line_of(text, "synthetic").startswith("--")
    assert "pip install -e '.[synthetic]'" in text
    assert "OpenGL" not in text  # the renderer needs none


def test_two_opencvs_are_one_too_many(monkeypatch):
    other = SimpleNamespace(metadata={"Name": "opencv-python"})
    both = [*metadata.distributions(), other]
    monkeypatch.setattr(doctor.metadata, "distributions", lambda: both)
    code, text = report()
    assert code == 1
    assert "2 in one folder" in line_of(text, "OpenCV")
    assert "uninstall -y opencv-python opencv-python-headless" in text


def test_an_opencv_of_which_another_ones_removal_left_the_folder_is_reported(monkeypatch, tmp_path):
    (tmp_path / "cv2").mkdir()
    installed = [SimpleNamespace(metadata={"Name": doctor.OPENCV})]
    monkeypatch.setattr(doctor.metadata, "distributions", lambda: installed)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    monkeypatch.delitem(sys.modules, "cv2")
    monkeypatch.setattr(doctor, "_fault_of_module", doctor._fault_of_module.__wrapped__)  # without its cache
    assert doctor._fault_of_module("cv2") == "only the folder is left"
    finding = doctor._package(doctor.OPENCV, "cv2")
    assert "does not load" in finding.found
    assert "uninstall -y" in finding.remedy


@pytest.mark.parametrize("asked", [None, "/some/where"])
def test_a_place_for_compiled_code_is_reported(monkeypatch, asked):
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    monkeypatch.setattr(warm_up, "kernels_are_cached", lambda: True)
    code, text = report()
    assert code == 0
    assert line_of(text, "cache").endswith("which can only be read: compiled")
    monkeypatch.setattr(warm_up, "kernels_are_cached", lambda: False)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if asked:
        monkeypatch.setenv("NUMBA_CACHE_DIR", asked)
    code, text = report()
    assert code == 1
    assert "every process compiles" in line_of(text, "cache")
    assert (asked or "the folder of the tracker") in line_of(text, "cache")
    assert "export NUMBA_CACHE_DIR=DIR" in text


@pytest.mark.parametrize("requirement", ['zmq>=1; extra == "live"', "zmq>=1 ; extra == 'live'"])
def test_extras_are_read_from_what_is_installed(monkeypatch, requirement):
    monkeypatch.setattr(doctor.metadata, "requires", lambda _: ["numpy", requirement])
    assert doctor._extras() == {"live": ["zmq"]}
