import os
import re

import pytest
from packaging.requirements import Requirement

from scripts import kept_environment
from scripts.kept_environment import forget_the_oldest, key, lay
from tests.helpers import ROOT, run_python


def test_the_name_tells_what_is_in_it(tmp_path):
    asked = tmp_path / "asked.txt"
    asked.write_text("numpy==1.24\n")
    names = [key([]), key(["."]), key([".[dev]"]), key(["-r", str(asked)])]
    asked.write_text("numpy==1.25\n")
    names.append(key(["-r", str(asked)]))
    assert len(set(names)) == 5
    assert key(["."]) == names[1]


def test_scripts_run_in_the_environment_that_is_laid(tmp_path):
    kept, laid = tmp_path / "kept", tmp_path / "laid"
    (kept / "bin").mkdir(parents=True)
    (kept / "bin" / "tool").write_text(f"#!{kept}/bin/python\n")
    (kept / "bin" / "tool").chmod(0o755)
    (kept / "pyvenv.cfg").write_text(f"command = python -m venv {kept}\n")
    (kept / "library.py").write_text("A = 1\n")
    lay(kept, laid)
    assert (laid / "bin" / "tool").read_text() == f"#!{laid}/bin/python\n"
    assert (laid / "bin" / "tool").stat().st_mode & 0o111
    assert (kept / "bin" / "tool").read_text() == f"#!{kept}/bin/python\n"
    assert (laid / "library.py").samefile(kept / "library.py")
    (laid / "stale").touch()
    lay(kept, laid)
    assert not (laid / "stale").exists()


def test_those_that_nobody_used_for_long_are_forgotten(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_environment, "KEPT", tmp_path)
    monkeypatch.setattr(kept_environment, "MOST", 1)
    for name in ("old", "new"):
        (tmp_path / name).mkdir()
        (tmp_path / f"{name}.installed").touch()
    os.utime(tmp_path / "old.installed", (0, 0))
    forget_the_oldest()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "new.installed"]


@pytest.mark.process
def test_every_requirement_of_those_who_use_it_states_a_lowest_version():
    extras = ("synthetic", "bench", "datasets", "rerun", "video")
    printed = run_python(["scripts/lowest_versions.py", *extras], check=True).stdout
    versions = dict(line.split("==") for line in printed.splitlines())
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8").lower()
    for name, version in versions.items():
        assert re.search(rf'^ +"{name}[>=]={re.escape(version)}["; ]', project, re.MULTILINE), name
    assert {"numpy", "pybullet", "pandas", "numcodecs", "lmdb", "rerun-sdk", "av", "pytest"} <= set(versions)
    assert {"ruff", "mypy"}.isdisjoint(versions)


def test_markers_of_what_extras_hold_reach_the_wheel():
    metadata = pytest.importorskip("hatchling.metadata.core", reason="needs the builder, hatchling")
    from hatchling.plugin.manager import PluginManager

    project = metadata.ProjectMetadata(str(ROOT), PluginManager()).core
    for extra in ("all", "dev"):
        (lcm,) = (one for one in map(Requirement, project.optional_dependencies[extra]) if one.name == "lcm")
        assert lcm.marker is not None
        for system, machine in (("darwin", "x86_64"), ("darwin", "arm64"), ("linux", "x86_64")):
            here = {"sys_platform": system, "platform_machine": machine}
            assert lcm.marker.evaluate(here) is ((system, machine) != ("darwin", "x86_64"))
