import json

import pytest

from scripts.try_numbers import TABLE, WAYS, numbers
from tests.helpers import ROOT, run_python


def test_the_table_has_all_numbers_of_the_estimator_by_name():
    text = TABLE.read_text(encoding="utf-8")
    assert not {number.name for number in numbers() if f"| `{number.name}` |" not in text}


def test_every_number_has_another_value_that_python_reads():
    for number in numbers():
        values = {way: number.changed(way) for way in WAYS}
        assert any(values.values()), number.name
        for value in filter(None, values.values()):
            compile(value, number.name, "eval")


@pytest.mark.parametrize(("name", "value"), [("CLOSE", 0.9), ("SHIFTS", -1.5), ("NUMBERS.pixel", 0.306)])
def test_a_changed_number_and_nothing_else_is_what_the_tracker_uses(name, value):
    (number,) = (one for one in numbers() if one.name == name)
    module, _, rest = number.file.removesuffix(".py").replace("/", ".").rpartition(".")
    code = f"""
import json, sys
from scripts.try_numbers import Number, change
given = json.loads(sys.argv[1])
change(Number(**given), sys.argv[2])
from {module} import {rest} as changed
found = changed.{name}
print(float(found if not hasattr(found, "__len__") else found[0]), changed.__file__)
"""
    given = json.dumps({**vars(number), "place": list(number.place)})
    done = run_python(["-c", code, given, number.changed("double")], check=True)
    found, file = done.stdout.split()
    assert float(found) == pytest.approx(value)
    assert file == str(ROOT / number.file)
