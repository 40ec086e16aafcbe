"""Processes that are begun import what this one does."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tracker.processes import python_command

pytestmark = pytest.mark.process


def test_modules_of_the_present_folder_are_not_imported(tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text("raise SystemExit('of the present folder')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    command = python_command("import json; print(json.dumps(sys.argv[1:]))", "a b", "--c")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ('["a b", "--c"]\n', "")
