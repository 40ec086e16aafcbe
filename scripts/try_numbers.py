"""Try every hand-set number of the estimator at half and at double its value.

    python scripts/try_numbers.py [NAME …]

Writes benchmarks/numbers.md: what each number is, where it stands, and what becomes of the poses. With names,
only these are tried again; those that were tried before are kept in build/numbers.
"""

import ast
import concurrent.futures
import importlib.util
import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.score.metrics import right, sure
from tracker.files import write_whole

ROOT = Path(__file__).resolve().parents[1]
ROOMS = "pose", "tracking", "segmentation"
KEPT, TABLE = ROOT / "build" / "numbers", ROOT / "benchmarks" / "numbers.md"

SEED, SCENES, FILMS, FRAMES = 424_242, 60, 8, 40
"""Development scenes: per object, 60 each of realistic ones and of `world`, and 8 films of 40 frames."""

WORKLOADS = (
    "realistic", "world", "absent", "two cameras", "one camera", "hard light", "poor images", "JPEG",
    "swapped", "other moment", "other calibration",
)  # fmt: skip
"""Those that are tried, with all look-alikes."""

HEAD = """\
# The estimator's numbers at half and at double their values

Written by scripts/try_numbers.py: {} and grids of them, each changed by itself, on {} and {} frames of \
films. As they are, {} and {} poses are right (within 5 mm and 5°), {} and {} wrong with a confidence above \
0.5, and {} sets without the object above 0.5.

A cell has the sets, then the frames: more or fewer right poses, wrong and sure ones, in sets also \
look-alikes above 0.5; then the mean error of poses that are right before and after, relative to before. \
Noise of one level changes these by up to −18, −9, −2 and × 1.10 in sets, +16, −13 and × 0.95 in frames: \
smaller changes mean little where most poses change. Of shares near 1, what they lack of it is halved and \
doubled; of priors, roots and squares are tried. What follows from other numbers, names columns or bounds \
buffers is left out.

Numbers whose text names no script were chosen on development scenes. One that does nothing here may save \
time, give the reason of a refusal, or serve other objects, rigs or images."""

COLUMNS = ["confidence", "mm", "deg", "present"]

WAYS = {"half": 0.5, "double": 2.0}

FROM_ONE = {
    "CLOSE", "SETTLED", "BACKGROUND", "LIKELIEST_SHARE", "FADING", "RESTS", "MOSTLY", "CONSTANT",
    "SHARED_SHARE", "temper",
}  # fmt: skip
"""Shares near 1: what they lack of it is halved and doubled."""

LAYOUT = {
    "BEFORE", "BITS", "BLOCK", "CELLS", "CLASSES", "EDGE", "EXPONENT", "FACE", "FAR", "FLAT", "GAUSSIAN",
    "IMPOSSIBLE", "KNOWN", "LEAST_PIVOT", "LIFTED", "MAX_PIXELS", "MAX_STRIPS", "MEASURING", "MIXED",
    "MOST_ODDS", "MOST_POINTS", "MOVING", "NODES", "NO_MOSAIC", "OWN", "PIECES", "PIXELS", "PLACES",
    "REFERENCE_SIZE", "ROUNDING", "ROWS", "SHARES", "STATE", "TILE", "UNKNOWNS", "WORN",
}  # fmt: skip
"""Constants that follow from others, name columns, or bound buffers and rounding errors."""


@dataclass(frozen=True)
class Number:
    """One number, or one grid of numbers, in the sources."""

    file: str
    name: str
    text: str
    """Its source text."""
    about: str
    place: tuple[int, int, int, int]
    """First line and column, last line and column, as in `ast`."""

    def changed(self, way: str) -> str | None:
        """Return the source of another value; None if it would be the same."""
        factor = WAYS[way]
        if not isinstance(value := ast.literal_eval(self.text), int | float):
            if "_PRIOR" in self.name:
                return f"(lambda p: p / p.sum())(np.array({self.text}) ** {factor})"
            return f"(np.array({self.text}) * {factor})"
        if self.name.split(".")[-1] in FROM_ONE:
            return repr(1 - (1 - value) * factor)
        other = int(value * factor) if isinstance(value, int) else value * factor
        return repr(other) if other not in (0, value) else None


def numbers() -> list[Number]:
    """Return all hand-set numbers of the rooms, in order."""
    files = sorted(path for room in ROOMS for path in (ROOT / "tracker" / room).glob("*.py"))
    return [number for path in files for number in _numbers_of(path)]


def _numbers_of(path: Path) -> Iterator[Number]:
    source, file = path.read_text(encoding="utf-8"), str(path.relative_to(ROOT))
    tree = ast.parse(source)
    records = {one.name: _texts(one.body) for one in tree.body if isinstance(one, ast.ClassDef)}
    texts = _texts(tree.body)
    for one in tree.body:
        if not isinstance(one, ast.Assign):
            continue
        names = [node.id for node in ast.walk(one.targets[0]) if isinstance(node, ast.Name)]
        private = any(name != name.upper() or name[0] == "_" for name in names)
        if private or not LAYOUT.isdisjoint(names) or "dtype" in ast.unparse(one.value):
            continue
        record = (
            one.value.func.id
            if isinstance(one.value, ast.Call) and isinstance(one.value.func, ast.Name)
            else ""
        )
        for name, node in _literals(one.value, names):
            field = name.partition(".")[2].partition("[")[0]
            about = records.get(record, {}).get(field) or texts.get(names[0], "")
            place = node.lineno, node.col_offset, node.end_lineno or 0, node.end_col_offset or 0
            yield Number(file, name, ast.get_source_segment(source, node) or "", about, place)


def _texts(body: list[ast.stmt]) -> dict[str, str]:
    """Return the first paragraph of the text below each assignment."""
    found = {}
    for one, after in itertools.pairwise(body):
        text = after.value if isinstance(after, ast.Expr) else None
        if isinstance(one, ast.Assign | ast.AnnAssign) and isinstance(text, ast.Constant):
            target = one.targets[0] if isinstance(one, ast.Assign) else one.target
            first = next(node.id for node in ast.walk(target) if isinstance(node, ast.Name))
            found[first] = " ".join(str(text.value).split("\n\n")[0].split())
    return found


def _literals(node: ast.expr, names: list[str], name: str = "") -> Iterator[tuple[str, ast.expr]]:
    """Yield each number of an expression that assigns `names`, with a name of its own."""
    whole = name or ", ".join(names)
    plain = node.operand if isinstance(node, ast.UnaryOp) else node
    if isinstance(plain, ast.Constant) and type(plain.value) in (int, float) and plain.value != 0:
        yield whole, node
    elif isinstance(node, ast.List | ast.Tuple):
        count = sum(isinstance(one, ast.Constant) for one in ast.walk(node))
        flat = isinstance(node, ast.List) or all(
            isinstance(one, ast.Constant | ast.UnaryOp) for one in node.elts
        )
        if "_PRIOR" in whole or (count > 4 and flat):
            yield whole, node
            return
        several = len(names) == len(node.elts) > 1 and not name
        for k, one in enumerate(node.elts):
            yield from _literals(one, names, names[k] if several else f"{whole}[{k}]")
    elif isinstance(node, ast.Call):
        several = isinstance(node.func, ast.Name)  # the fields of a record; other functions have options
        for k, one in enumerate(node.args if several else node.args[:1]):
            yield from _literals(one, names, f"{whole}[{k}]" if several else whole)
        for keyword in node.keywords:
            yield from _literals(keyword.value, names, f"{whole}.{keyword.arg}")
    elif isinstance(node, ast.BinOp):
        for one in (node.left, node.right):
            if not (isinstance(one, ast.Constant) and isinstance(one.value, int)):  # a count, or a power
                yield from _literals(one, names, whole)


class _Changed(SourceFileLoader):
    """Loads the module of a number with another value in its place."""

    number: Number
    value: str

    def get_code(self, fullname: str):  # type: ignore[no-untyped-def]
        lines = Path(self.path).read_bytes().splitlines(keepends=True)
        first, left, last, right = self.number.place
        new = lines[first - 1][:left] + self.value.encode() + lines[last - 1][right:]
        return compile(b"".join([*lines[: first - 1], new, *lines[last:]]), self.path, "exec")


def change(number: Number, value: str) -> None:
    """Make Python import the module of a number with another value in its place."""
    module = number.file.removesuffix(".py").replace("/", ".")

    class Finder:
        @staticmethod
        def find_spec(name: str, path: object, target: object = None) -> ModuleSpec | None:
            if name != module:
                return None
            loader = _Changed(name, str(ROOT / number.file))
            loader.number, loader.value = number, value
            return importlib.util.spec_from_file_location(name, loader.path, loader=loader)

    sys.meta_path.insert(0, Finder)  # type: ignore[arg-type]


def answers() -> pd.DataFrame:
    """Return a row for each set of images and each frame of the films.

    `frame`: whether it is one of a film; `confidence`; errors `mm` and `deg`; `present`: whether the object,
    not something like it, is in view.
    """
    from benchmarks.data.films import FilmStore
    from benchmarks.data.plan import LOOK_ALIKE, Plan
    from benchmarks.data.scenes import OBJECTS, rig
    from benchmarks.data.workloads import WORKLOADS as ALL
    from benchmarks.measure.accuracy import measure_accuracy
    from benchmarks.measure.films import play
    from benchmarks.measure.timing import one_thread
    from tracker.pipeline import ObjectTracker

    plan = Plan(SCENES, SEED)
    tried = [one for one in ALL if one.name in WORKLOADS or one.name.startswith(LOOK_ALIKE)]
    sets, _ = measure_accuracy(plan, tried, OBJECTS)
    sets["present"] &= ~sets.group.str.startswith(LOOK_ALIKE)
    frames = []
    for name in OBJECTS:
        store = FilmStore(name, "errors", FRAMES, plan)
        store.prepare(range(FILMS), vanishing=False)
        for film in range(FILMS):
            shown = list(store.frames(film, range(FRAMES)))
            with one_thread():
                frames.append(play(ObjectTracker(name, shown[0].rigs(rig())[1]), shown))
    parts = [part[COLUMNS].assign(frame=part is not sets) for part in (sets, *frames)]
    return pd.concat(parts, ignore_index=True)


@dataclass(frozen=True)
class Outcome:
    """Figures of a run; `right`: within 5 mm and 5° of the truth."""

    right: int
    wrong: int
    """Wrong poses with a confidence above 0.5."""
    alike: int
    """Poses above 0.5 where the object is not in view."""


def outcome(rows: pd.DataFrame) -> Outcome:
    """Return the figures of answers."""
    good, certain = right(rows) & rows.present, sure(rows)
    return Outcome(
        int(good.sum()), int((certain & ~good & rows.present).sum()), int((certain & ~rows.present).sum())
    )


def _effect(before: pd.DataFrame, after: pd.DataFrame) -> str:
    """Return what became of the poses, as a cell of the table."""
    cells = []
    for frame in (False, True):
        one, other = before[before.frame == frame], after[after.frame == frame]
        if np.allclose(one[COLUMNS[:3]], other[COLUMNS[:3]], rtol=0, atol=1e-3, equal_nan=True):
            cells.append("the same")
            continue
        was, now, both = outcome(one), outcome(other), right(one) & right(other)
        errors = [rows.loc[both, ["mm", "deg"]].to_numpy().clip(1e-4) for rows in (one, other)]
        changes = [f"{getattr(now, k) - getattr(was, k):+d}" for k in ("right", "wrong", "alike")]
        error = np.exp(np.mean(np.log(errors[1] / errors[0])))
        cells.append(f"{', '.join(changes[:2] if frame else changes)}; × {error:.2f}")
    return " \\| ".join(cells).replace("-", "−").replace("+0", "0")


def _run(job: tuple[str, Number | None, str]) -> pd.DataFrame | None:
    """Answer all sets and films in a process of its own, unless the answers are kept; None: it failed."""
    name, number, value = job
    file = KEPT / f"{name}.csv"
    if not file.is_file():
        kernels = KEPT / f"kernels {name}"
        given = json.dumps([str(file), asdict(number) if number else None, value])
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels)}
        subprocess.run([sys.executable, __file__, "--answer", given], env=environment, cwd=ROOT, check=False)
        shutil.rmtree(kernels, ignore_errors=True)
    return pd.read_csv(file) if file.is_file() else None


def _answer(file: str, number: dict | None, value: str) -> None:
    if number is not None:
        change(Number(**{**number, "place": tuple(number["place"])}), value)
    write_whole(file, answers().to_csv(index=False))


def _table(rows: dict[Number, dict[str, str]], base: pd.DataFrame) -> str:
    sets, frames = (outcome(base[base.frame == frame]) for frame in (False, True))
    counts = f"{len(rows)} hand-set numbers", f"{(~base.frame).sum()} development sets", base.frame.sum()
    given = (*counts, sets.right, frames.right, sets.wrong, frames.wrong, sets.alike)
    lines = [HEAD.format(*given)]
    for file in dict.fromkeys(number.file for number in rows):
        lines += ["", f"## {file}", "", "| number | value | what it is | half | double |", "| --- " * 5 + "|"]
        about = ""
        for number in (one for one in rows if one.file == file):
            text, about = "" if number.about == about else number.about.replace("|", "\\|"), number.about
            cell = " | ".join(rows[number].get(way, "") for way in WAYS)
            lines.append(f"| `{number.name}` | {' '.join(number.text.split())} | {text} | {cell} |")
    return "\n".join([*lines, ""])


def main(names: list[str]) -> None:
    """Try all numbers, or those with these names again; write the table."""
    KEPT.mkdir(parents=True, exist_ok=True)
    base = _run(("as it is", None, ""))
    assert base is not None
    found = numbers()
    jobs = []
    for k, number in enumerate(found):
        for way in WAYS:
            if (value := number.changed(way)) is None:
                continue
            same = sum(one.file == number.file and one.name == number.name for one in found[:k])
            name = f"{number.file.removesuffix('.py').replace('/', '.')}.{number.name} {same} {way}"
            if number.name in names:
                (KEPT / f"{name}.csv").unlink(missing_ok=True)
            jobs.append((number, way, (name, number, value)))
    rows: dict[Number, dict[str, str]] = {}
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        done = pool.map(_run, [job for _, _, job in jobs])
        for (number, way, (name, _, _)), after in zip(jobs, done, strict=True):
            cell = "fails" if after is None else _effect(base, after)
            rows.setdefault(number, {})[way] = cell
            print(name, cell, flush=True)
    write_whole(TABLE, _table(rows, base))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--answer"]:
        _answer(*json.loads(sys.argv[2]))
    else:
        main(sys.argv[1:])
