import re

import pytest

from tests.helpers import ROOT, run_python

pytestmark = pytest.mark.process

EXTRAS = ("synthetic", "bench", "datasets", "rerun", "video")


def test_every_requirement_of_those_who_use_it_states_a_lowest_version():
    printed = run_python(["scripts/lowest_versions.py", *EXTRAS], check=True).stdout
    versions = dict(line.split("==") for line in printed.splitlines())
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8").lower()
    for name, version in versions.items():
        assert re.search(rf'^ +"{name}[>=]={re.escape(version)}["; ]', project, re.MULTILINE), name
    assert {"numpy", "pybullet", "pandas", "numcodecs", "lmdb", "rerun-sdk", "av", "pytest"} <= set(versions)
    assert {"ruff", "mypy"}.isdisjoint(versions)
