import ast
import math
import os
import re
from functools import cache

import pytest

from tests.helpers import ROOT
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.pose import align, edge_fit, judge, sizes, solve, support

DOCUMENT = ROOT / "docs" / "how-it-works.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
NAMED = re.compile(r"\[`(?P<path>[\w./]+\.py)`\]\((?P<link>[^)]+)\)(?P<names>:(?:,? (?:and )?`\w+`)+)?")
REFERENCE = re.compile(r"equation \((\d+)\) of docs/how-it-works\.md")


@cache
def docstrings(path: str) -> dict[str, str]:
    """What a file defines, functions and classes with their docstrings, whitespace made even."""
    found: dict[str, str] = {}
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found[node.name] = " ".join((ast.get_docstring(node) or "").split())
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found.update({target.id: "" for target in targets if isinstance(target, ast.Name)})
    return found


def named(text: str) -> list[tuple[str, str]]:
    """(file, name) of all that a text says is in a file."""
    return [
        (match["path"], name)
        for match in NAMED.finditer(text)
        for name in re.findall(r"`(\w+)`", match["names"] or "")
    ]


WHERE = re.findall(r"\\tag\{(\d+)\}\n```\n\nWhere: ([^\n]+)", TEXT)
HOLDERS = {number: set(named(where)) for number, where in WHERE}
"""Of each equation what holds it: the files and names in the line "Where" below it."""


def test_the_text_refers_to_equations_that_exist_and_every_equation_says_what_holds_it():
    words = re.sub(r"(?s)```.*?```|\$[^$\n]+\$", "", TEXT)
    assert set(re.findall(r"\((\d+)\)", words)) <= set(HOLDERS)
    assert {number for number, where in HOLDERS.items() if where} == set(re.findall(r"\\tag\{(\d+)\}", TEXT))


def test_every_file_and_function_that_the_document_names_exists():
    matches = list(NAMED.finditer(TEXT))
    assert len(matches) > 30
    for match in matches:
        target = (DOCUMENT.parent / match["link"]).resolve()
        assert target == ROOT / match["path"]
        assert target.is_file(), target
    for path, name in named(TEXT):
        assert name in docstrings(path), f"{path}: {name}"


def test_code_and_document_name_each_other_at_every_equation():
    referred = set()
    for path in ROOT.glob("tracker/**/*.py"):
        file, text = path.relative_to(ROOT).as_posix(), " ".join(path.read_text(encoding="utf-8").split())
        for name, docstring in docstrings(file).items():
            for number in REFERENCE.findall(docstring):
                assert (file, name) in HOLDERS[number], f"equation ({number}) in {file}: {name}"
                referred.add(number)
        assert set(re.findall(r"(?i:equation) \((\d+)\)", text)) <= set(HOLDERS), path
    assert referred == set(HOLDERS)


@pytest.mark.parametrize(
    "shown",
    [
        f"0,\\,{align.HIDDEN:g} + \\frac{{\\mathrm{{agree}} - {align.HIDDEN:g}\\,\\mathrm{{missing}}",
        f"{{\\mathrm{{predicted}} + {align.EXPECTED}}}",
        f"$0 \\pm {edge_fit.SLOPE:g}$ levels/px (less if $b < {edge_fit.SOFT:g}$ px)",
        f"{solve.TUKEY:g}\\,\\mathrm{{scatter}}",
        f"\\max({solve.FLOOR:g},",
        f"1 / {solve.DEVIATION_STD:g}^2",
        f"increase $\\alpha$, up to {sizes.SHARES.max():g}",
        f"+ 10^{{{2 * math.log10(solve.MODEL_STD):g}}}\\,",
        f"odds are multiplied by {judge.SINGLE:g}",
    ],
)
def test_numbers_in_the_text_are_those_of_the_code(shown):
    assert shown in TEXT


def test_the_ways_to_be_placed_on_the_table_are_those_of_the_code():
    rows = re.findall(r"^\| [^|]+ \| ([\d.]+) \| ([^|]+) \| ([^|]+) \|$", TEXT, flags=re.MULTILINE)
    sizes = {"6": support.FACE_WAYS, r"$6\pi$": support.EDGE_WAYS, r"$4\pi \cdot 0.15$ m": 0.3 / support.FREE}
    assert list(sizes.values()) == [6.0, 6 * math.pi, pytest.approx(4 * math.pi * 0.15)]
    assert [(float(probability), sizes[size], deviations) for probability, size, deviations in rows] == [
        *((way[0], support.FACE_WAYS, _deviations(*way[1:])) for way in support.FLAT),
        (support.LEANING[0], support.EDGE_WAYS, _deviations(*support.LEANING[1:])),
        (0.3, 0.3 / support.FREE, "–"),
    ]


def _deviations(height: float, angle: float) -> str:
    return f"{1e3 * height:g} mm, {math.degrees(angle):g}°"


def test_the_script_draws_every_picture(tmp_path, run_script):
    pytest.importorskip("matplotlib", reason="plot: no module matplotlib")
    skip_without_platform()
    script = ROOT / "scripts" / "draw_how_it_works.py"
    run_script(script, "--quick", "--output", tmp_path, folder=tmp_path)
    assert set(os.listdir(tmp_path)) == set(os.listdir(DOCUMENT.parent / "how-it-works"))
