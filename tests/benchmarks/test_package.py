from __future__ import annotations

import sys
from pathlib import Path

import pytest

from benchmarks.data.package import environment as package
from benchmarks.data.package.environment import PACKAGE, VARIABLE, VERSION, PackageError, interpreter, run


@pytest.fixture(autouse=True)
def _no_interpreter_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands that were asked for; of these, only those that make environments were run."""
    asked: list[list[str]] = []

    def run_some(command: list[str]) -> str:
        asked.append(command)
        return run([*command, "--without-pip"]) if "venv" in command else ""

    monkeypatch.setattr(package, "run", run_some)
    return asked


def test_an_interpreter_that_is_chosen_has_to_be_there(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, sys.executable)
    assert interpreter(tmp_path) == Path(sys.executable)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(PackageError, match="nowhere: no such file"):
        interpreter(tmp_path)


def test_nothing_is_installed_unless_requested(tmp_path):
    with pytest.raises(PackageError, match="not installed"):
        interpreter(tmp_path, install=False)
    assert not list(tmp_path.iterdir())


def test_an_environment_is_made_once(tmp_path, commands):
    python = interpreter(tmp_path)
    assert python.is_file()
    assert python.is_relative_to(tmp_path)
    assert any(f"{PACKAGE}=={VERSION}" in command for command in commands)
    count = len(commands)
    assert interpreter(tmp_path, install=False) == python
    assert len(commands) == count


def test_what_an_interruption_left_unfinished_is_made_again(tmp_path, commands, monkeypatch):
    def interrupted(command: list[str]) -> str:
        if "install" in command:
            raise KeyboardInterrupt
        return run([*command, "--without-pip"])

    with monkeypatch.context() as patch:
        patch.setattr(package, "run", interrupted)
        with pytest.raises(KeyboardInterrupt):
            interpreter(tmp_path)
    root = tmp_path / f"{PACKAGE}-{VERSION}"
    (root / "half a package").mkdir()
    with pytest.raises(PackageError, match="not installed"):
        interpreter(tmp_path, install=False)
    assert interpreter(tmp_path).is_file()
    assert not (root / "half a package").exists()


def test_an_environment_whose_python_has_gone_is_made_again(tmp_path, commands):
    python = interpreter(tmp_path)
    python.unlink()
    with pytest.raises(PackageError, match="not installed"):
        interpreter(tmp_path, install=False)
    assert interpreter(tmp_path).is_file()


def test_a_command_that_fails_says_why_in_one_line():
    assert run([sys.executable, "-c", "print('printed')"]) == "printed\n"
    with pytest.raises(PackageError, match=f"^{PACKAGE}: the reason$"):
        run([sys.executable, "-c", "import sys; sys.exit('more\\nthe reason')"])
    with pytest.raises(PackageError, match="No such file"):
        run(["/nowhere/python"])
