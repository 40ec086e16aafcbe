"""What users may rely on changes on purpose only."""

from __future__ import annotations

import importlib
import re

from scripts.public_api import SNAPSHOT, public_api
from tests.helpers import ROOT

NAME = re.compile(r"^(?:class )?(tracker[\w.]*)\.(\w+)", re.MULTILINE)


def test_the_public_names_and_their_signatures_are_those_of_the_snapshot():
    assert public_api() == SNAPSHOT.read_text(encoding="utf-8"), (
        "The public interface has changed. If that is meant: python scripts/public_api.py, and CHANGELOG.md."
    )


def test_every_name_of_the_snapshot_is_there():
    names = NAME.findall(public_api())
    assert len(names) > 60
    for module, name in names:
        assert hasattr(importlib.import_module(module), name), f"{module}.{name}"


def test_the_changelog_tells_what_is_unreleased_and_then_of_versions():
    sections = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sections[0] == "Unreleased"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", section) for section in sections[1:])
    assert len(set(sections)) == len(sections)
