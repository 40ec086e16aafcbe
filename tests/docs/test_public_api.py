import dataclasses
import importlib
import inspect
import re
from functools import cache

import tracker
from scripts.public_api import SNAPSHOT, public_api
from tests.docs.samples import PAGES
from tests.helpers import ROOT

stated = cache(public_api)

NAME = re.compile(r"^(?:class )?(tracker[\w.]*)\.(\w+)", re.MULTILINE)

NO_NAMES = {"tracker.update", "tracker.reset", "tracker.h", "tracker.yml"}
"""What pages write of other things that are called `tracker`."""


def test_the_public_names_and_their_signatures_are_those_of_the_snapshot_and_are_there():
    assert stated() == SNAPSHOT.read_text(encoding="utf-8"), (
        "The public interface has changed. If that is meant: python scripts/public_api.py, and CHANGELOG.md."
    )
    names = NAME.findall(stated())
    assert len(names) > 60
    for module, name in names:
        assert hasattr(importlib.import_module(module), name), f"{module}.{name}"


def test_help_describes_every_field_of_a_public_class():
    classes = [one for one in (getattr(tracker, name) for name in tracker.__all__) if inspect.isclass(one)]
    fields = {one: dataclasses.fields(one) for one in classes if dataclasses.is_dataclass(one)}
    assert len(fields) > 8
    for one, its in fields.items():
        shown = "\n".join(inspect.cleandoc(base.__doc__ or "") for base in one.__mro__)
        assert [field.name for field in its if f"\n    {field.name}: " not in shown] == [], one


def test_what_a_page_or_an_example_recommends_is_public_and_in_the_reference():
    reference = PAGES["docs/reference"]
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "examples").glob("*.py")]
    texts += [PAGES[name] for name in set(PAGES) - {"README", "docs/commands", "docs/reference"}]
    public = {".".join(parts) for parts in NAME.findall(stated())}
    named = {name for text in texts for name in re.findall(r"\btracker(?:\.[a-z_]\w*)*\.[A-Za-z]\w*", text)}
    for module, names in re.findall(r"^from (tracker[\w.]*) import (.+)$", "\n".join(texts), re.MULTILINE):
        named |= {f"{module}.{name.strip()}" for name in names.split(",")}
    for name in sorted(named - NO_NAMES):
        home = next((one for one in (name, name.rpartition(".")[0]) if one in public), None)
        is_module = any(one.startswith(f"{name}.") for one in public)
        assert home or is_module, f"{name}: in no line of tests/public_api.txt"
        if home:
            module, _, last = home.rpartition(".")
            value = getattr(importlib.import_module(module), last)
            source = getattr(value, "__module__", module)
            homes = {f"{source}.{last}", source, home, module}
            assert any(f"::: {one}\n" in f"{reference}\n" for one in homes), f"{name}: not in the reference"
