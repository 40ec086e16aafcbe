import ast
import contextlib
import gc
import importlib
import io
import json
import multiprocessing
import os
import re
import shutil
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.runtime import _nrt_python, rtsys

from tests.helpers import ROOT, run_python
from tracker import ObjectTracker, open_log
from tracker.cli.demo import DATA
from tracker.compiled import _place, compiled, fingerprint, is_cached


@compiled
def halves(values):
    total = 0.0
    for value in values:
        total += value / 2
    return total


@compiled(inline="always")
def ratio(a, b):
    return a / b


@compiled
def ratios(a, b):
    return ratio(a, b)


@compiled
def times(value, count):
    return value * count


@compiled
def times_three_and_four(value):
    return times(value, 3) + times(value, 4)


def test_what_kernels_call_has_no_machine_code_and_is_compiled_once_for_all_written_out_numbers():
    assert times_three_and_four(1.5) == 10.5
    for number in (3, 4):  # as a caller asks that is not on disk yet
        template, *_ = times.get_call_template((types.float64, types.literal(number)), {})
        assert len(template.cases) == 1
    assert not times.signatures
    assert times(1.5, 3) == 4.5
    assert len(times.signatures) == 1
    # A compiled function gives what Python and NumPy give, and lets other threads run.
    values = np.arange(5.0)
    assert halves(values) == halves.py_func(values) == 5.0
    assert [ratios(a, b) for a, b in ((1.0, 4.0), (1.0, 0.0), (-1.0, 0.0))] == [0.25, np.inf, -np.inf]
    assert np.isnan(ratios(0.0, 0.0))
    assert halves.targetoptions["nogil"]


@compiled
def same(values):
    return values, 1.0


@compiled
def sum_of_same(values):
    return same(values)[0].sum()


def test_a_kernel_without_counted_references_must_not_return_arrays():
    # Old versions of numba wrap the error.
    with pytest.raises((TypeError, numba.TypingError), match="same: returns an array, but creates none"):
        sum_of_same(np.ones(3))


def test_kernels_free_all_arrays_that_they_create():
    with open_log(DATA) as log:
        frames, rig = list(log)[:3], log.rig
    kept = []
    _nrt_python.memsys_enable_stats()
    try:
        for _ in range(8):
            for name in ("cube_v2", "cuboid_2x2x8_v2"):
                tracker = ObjectTracker(name, rig)
                for frame in frames:
                    tracker.detect([frame.images[0], None, None])
                    tracker.update(frame.images, frame.timestamp)
                tracker.update(frames[0].images, [frame.timestamp + 0.1 + 0.01 * c for c in range(3)])
                tracker.predict(frame.timestamp + 0.5)
            del tracker
            gc.collect()
            stats = rtsys.get_allocation_stats()
            kept.append((stats.alloc - stats.free, stats.mi_alloc - stats.mi_free))
    finally:
        _nrt_python.memsys_disable_stats()
    # Caches of judgements fill in the first rounds, and replace arrays of earlier tests: there may be fewer.
    assert kept[-1][0] <= kept[-2][0]
    assert kept[-1][1] <= kept[-2][1]


def test_kernels_assign_nothing_but_numbers_to_slices():
    # Numba compiles the error message of arrays that do not match as well, which takes two seconds.
    number, slow = re.compile(r"-?[\d.e]+|np\.(nan|inf|float32\(0\.0\))|False"), []
    for path in (ROOT / "tracker").rglob("*.py"):
        for kernel in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            decorators = map(ast.unparse, getattr(kernel, "decorator_list", []))
            if not any(name.startswith("compiled") for name in decorators):
                continue
            for node in ast.walk(kernel):
                if not isinstance(node, (ast.Assign, ast.AugAssign)):
                    continue
                target = node.target if isinstance(node, ast.AugAssign) else node.targets[-1]
                both = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                pairs = zip(target.elts, node.value.elts, strict=True) if both else [(target, node.value)]
                slow += [
                    f"{path.name}: {ast.unparse(node)}"
                    for part, value in pairs
                    if isinstance(part, ast.Subscript)
                    and any(isinstance(index, ast.Slice) for index in ast.walk(part.slice))
                    and not (number.fullmatch(ast.unparse(value)) and isinstance(node, ast.Assign))
                ]
    assert slow == []


SCRIPT = """
import json
import numpy as np
import tracker
from numba.core.caching import NullCache
from tracker.geometry.lens import apply_update
from tracker.pose.refine import refine

rotation, position = np.eye(3), np.zeros(3)
apply_update(rotation, position, np.array([1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]))
unkept = all(isinstance(kernel._cache, NullCache) for kernel in (refine, apply_update))
print(json.dumps([tracker.__file__, unkept, position.tolist(), rotation.round(9).tolist()]))
"""


def test_kernels_are_compiled_where_none_can_be_kept(tmp_path, monkeypatch):
    # A copy of the package, beside which, as anywhere else, a file is where a folder is needed: that stops
    # every user; a folder's permissions do not stop root.
    leave_out = shutil.ignore_patterns("__pycache__", "*.nb[ci]")
    shutil.copytree(ROOT / "tracker", tmp_path / "tracker", ignore=leave_out)
    for folder in {path.parent for path in tmp_path.rglob("*.py")}:
        (folder / "__pycache__").touch()
    (tmp_path / "file").touch()
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "IPYTHONDIR", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(tmp_path / "file" / "below"))
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    printed = run_python(["-W", "error", "-c", SCRIPT], tmp_path, check=True).stdout
    rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    file = str(tmp_path / "tracker" / "__init__.py")
    assert json.loads(printed) == [file, True, [1.0, 2.0, 3.0], rotation]


ALL = {
    "__init__.py": "",
    "constants.py": "FACTOR = 2.0\n",
    "inner.py": """
from tracker.compiled import compiled
from toy.constants import FACTOR

@compiled
def inner(x):
    return FACTOR * x + 1.0
""",
    "outer.py": """
from tracker.compiled import compiled
from toy.inner import inner

@compiled
def outer(x):
    return inner(x)
""",
    "unrelated.py": "NOTHING = 0\n",
}

TOY = """
import json
from toy.outer import outer

print(json.dumps([outer(3.0), sum(outer.stats.cache_hits.values())]))
"""


def answer(folder, script, sender):
    """Send what a script prints; the target of a process."""
    sys.path.insert(0, folder)
    numba.config.CACHE_DIR = ""  # where machine code is kept beside its sources
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(script, "script.py", "exec"), {})
    sender.send(printed.getvalue())


def in_new_process(folder, script):
    """What a script prints as JSON in a new process, which finds numba loaded."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "tests.helpers.begun"])
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=answer, args=(str(folder), script, sender))
    process.start()
    sender.close()
    printed = receiver.recv()
    process.join()
    return json.loads(printed)


@pytest.fixture
def toy(tmp_path):
    """A package of one kernel that calls another one of another file; its machine code is kept beside it."""
    (tmp_path / "toy").mkdir()
    for name, text in ALL.items():
        (tmp_path / "toy" / name).write_text(text, encoding="utf-8")
    return tmp_path


def kept(toy):
    """Folders of machine code."""
    return set((toy / "toy" / "__pycache__").glob("kernels-*"))


def edit(toy, name, old, new):
    path = toy / "toy" / name
    stamp = path.stat().st_mtime + 2
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    # Bytecode of a file that is as long, and was changed in the same second, counts as new.
    os.utime(path, (stamp, stamp))


def test_a_change_in_what_a_kernel_calls_or_imports_and_damage_lead_to_new_machine_code(toy):
    assert in_new_process(toy, TOY) == [7.0, 0]
    for pattern in ("*.nbi", "*.nbc"):
        (folder,) = kept(toy)
        for file in folder.glob(pattern):
            file.write_bytes(b"none")
        assert in_new_process(toy, TOY) == [7.0, 0]
    assert in_new_process(toy, TOY) == [7.0, 1]
    edit(toy, "inner.py", "1.0", "2.0")
    assert in_new_process(toy, TOY) == [8.0, 0]
    edit(toy, "constants.py", "2.0", "3.0")
    assert in_new_process(toy, TOY) == [11.0, 0]
    edit(toy, "unrelated.py", "0", "1")
    (toy / "toy" / ".#inner.py").symlink_to("user@host.1:2")  # of an editor that has inner.py open
    (toy / "toy" / "._inner.py").write_bytes(b"\xff")  # of a file system for Macs
    assert in_new_process(toy, TOY) == [11.0, 1]


def test_what_a_script_compiles_is_as_new_as_the_package_whose_kernels_it_may_call(tmp_path, monkeypatch):
    (tmp_path / "one_file.py").write_text(
        "from tracker.compiled import compiled\n\n@compiled\ndef twice(x):\n    return 2 * x\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    twice = importlib.import_module("one_file").twice
    assert not is_cached(twice)
    assert twice(2) == 4
    assert is_cached(twice)
    with monkeypatch.context() as other:
        other.setattr(numba.config, "CPU_NAME", "generic")
        assert not is_cached(twice)
    for index in Path(twice.stats.cache_path).glob("one_file.twice-*.nbi"):
        index.write_bytes(b"")
    assert not is_cached(twice)
    assert fingerprint("tracker") in twice._cache._impl.locator.get_source_stamp()


def test_machine_code_of_older_sources_is_removed_but_for_the_latest(toy, monkeypatch):
    folders = []
    for k in range(2, 5):
        edit(toy, "constants.py", f"{k}.0", f"{k + 1}.0")
        before = kept(toy)
        in_new_process(toy, TOY)
        folders += kept(toy) - before
    assert len(folders) == 3
    assert kept(toy) == set(folders[-2:])
    # Where copies share a folder, that of eight other sources stays.
    shared = toy / "shared"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(shared))
    for number in range(12):
        os.utime(_place(shared, f"kernels-{number:02}"), (number, number))
    assert sorted(os.listdir(shared)) == [f"kernels-{number:02}" for number in range(3, 12)]


def test_copies_of_a_package_share_machine_code_where_a_folder_is_named(toy):
    shared = f"import numba\nnumba.config.CACHE_DIR = {str(toy / 'shared')!r}\n"
    assert in_new_process(toy, shared + TOY) == [7.0, 0]
    shutil.copytree(toy / "toy", toy / "elsewhere" / "toy")
    assert in_new_process(toy / "elsewhere", shared + TOY) == [7.0, 1]
    edit(toy / "elsewhere", "inner.py", "1.0", "2.0")
    assert in_new_process(toy / "elsewhere", shared + TOY) == [8.0, 0]
    assert in_new_process(toy, shared + TOY) == [7.0, 1]
    assert kept(toy) == kept(toy / "elsewhere") == set()


def test_python_without_docstrings_reads_the_machine_code_of_python_with_them(toy):
    edit(toy, "outer.py", "    return", '    """Call another."""\n    _ = None\n    return')
    assert in_new_process(toy, TOY) == [7.0, 0]
    beside = "import numba\nnumba.config.CACHE_DIR = ''\n"
    assert json.loads(run_python(["-OO", "-c", beside + TOY], toy, check=True).stdout) == [7.0, 1]


def test_machine_code_of_others_is_read_where_none_can_be_kept_or_not_any_more(toy):
    read_only = """
from numba.core import caching

def refuse(self):
    raise OSError(30, "Read-only file system")

caching._CacheLocator.ensure_cache_path = refuse
"""
    assert in_new_process(toy, read_only + TOY) == [7.0, 0]
    assert kept(toy) == set()
    assert in_new_process(toy, TOY) == [7.0, 0]
    assert in_new_process(toy, read_only + TOY) == [7.0, 1]
    # Nor does another folder that cannot even be looked into, as of another user, keep it from being found.
    other = f"import numba\nnumba.config.CACHE_DIR = '/{'a' * 256}'\n"
    assert in_new_process(toy, other + read_only + TOY) == [7.0, 1]
    edit(toy, "inner.py", "1.0", "2.0")
    assert in_new_process(toy, read_only + TOY) == [8.0, 0]
    assert len(kept(toy)) == 1
    gone = """
import pathlib, shutil
from toy.outer import outer

folder = pathlib.Path(outer.stats.cache_path)
shutil.rmtree(folder)
folder.touch()
"""
    assert in_new_process(toy, gone + TOY) == [8.0, 0]
