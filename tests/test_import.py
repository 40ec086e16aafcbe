import ast
import importlib
import operator
import re
from pathlib import Path

import pytest

import tracker
from scripts.public_api import SNAPSHOT
from tests.helpers import ROOT, run_python
from tracker.version import version
from tracker.warm_up import warm_up

pytestmark = pytest.mark.process


def test_help_is_given_without_the_libraries_that_take_long_to_load():
    result = run_python(["-X", "importtime", "-m", "tracker", "--help"], check=True)
    assert result.stdout.startswith("Usage: tracker")
    modules = {line.rpartition("|")[2].strip().partition(".")[0] for line in result.stderr.splitlines()}
    assert {"click", "tracker"} <= modules
    assert not {"numba", "cv2", "scipy", "numpy", "h5py", "yaml", "PIL"} & modules


def test_a_first_pose_does_without_the_packages_of_scipy_that_take_long_to_load():
    script = (
        "LONG = 'scipy.linalg', 'scipy.ndimage', 'scipy.optimize', 'scipy.special'\n"
        "import sys; from tracker.cli import main\n"
        "try: main(['detect', 'tracker/demo/000000', '--object', 'cube_v2'])\n"
        "except SystemExit: print([name for name in sys.modules if name.startswith(LONG)])\n"
        "import numba, numpy; print(numba.njit(lambda values: numpy.linalg.norm(values))(numpy.ones(4)))"
    )
    warm_up()
    printed = run_python(["-c", script], check=True).stdout
    assert "confidence" in printed
    # What is compiled later finds all that a compiler needs.
    assert printed.endswith("[]\n2.0\n")


IMPORTS = """
import sys, tracker
print({"numpy", "cv2", "numba", "importlib.metadata"} & set(sys.modules))
print(tracker.__version__)
print({"move_object", "rearrange_dice"} - set(dir(tracker.tasks)))
print(tracker.geometry.so3.exp([0, 0, 0])[0, 0], tracker.viz.__name__, "matplotlib" in sys.modules)
from tracker import tasks
print(tasks.rearrange_dice.NUM_DICE, tasks.move_object.LEVELS[3], tracker.live.platform.Frontend.__name__)
"""


def test_the_import_alone_is_quick_and_packages_are_there_by_their_names():
    printed = run_python(["-c", IMPORTS], check=True).stdout
    assert printed.splitlines() == ["set()", version(), "set()", "1.0 tracker.viz False", "25 4 Frontend"]


def test_every_public_name_is_there_after_the_import_alone():
    names = re.findall(r"^(?:class )?tracker\.([\w.]+)", SNAPSHOT.read_text("utf-8"), re.MULTILINE)
    code = f"import operator, tracker\nfor name in {names}: operator.attrgetter(name)(tracker)"
    run_python(["-c", code], check=True)


@pytest.mark.parametrize("before", ["tracker.load_object('cube_v2')", "tracker.Arena()", "tracker.Camera"])
def test_rotations_are_there_by_name_whatever_ran_before(before):
    code = f"import tracker; {before}; print(tracker.geometry.so3.exp([0, 0, 0])[0, 0])"
    assert run_python(["-c", code], check=True).stdout == "1.0\n"


def test_every_public_name_is_the_one_that_type_checkers_see_and_others_are_attribute_errors():
    homes, packages = {}, []
    for node in ast.walk(ast.parse(Path(tracker.__file__).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module == "tracker":
            packages += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("tracker."):
            homes |= dict.fromkeys((alias.name for alias in node.names), node.module)
    assert sorted(homes) == sorted(tracker.__all__)
    for name, home in homes.items():
        assert getattr(tracker, name) is getattr(importlib.import_module(home), name)
    for package in packages:
        assert getattr(tracker, package) is importlib.import_module(f"tracker.{package}")
    assert {*tracker.__all__, *packages, "__version__"} <= set(dir(tracker))
    for none in ("Tracker", "_Tracker", "packages", "tasks.score"):
        with pytest.raises(AttributeError, match=none.rpartition(".")[2]):
            operator.attrgetter(none)(tracker)


@pytest.mark.parametrize("script", sorted((ROOT / "scripts").glob("*.py")), ids=lambda path: path.stem)
def test_what_a_script_imports_of_the_tracker_is_there(script):
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("tracker"):
            for alias in node.names:
                assert hasattr(importlib.import_module(node.module), alias.name)
