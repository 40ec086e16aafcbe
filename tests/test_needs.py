import re

import pytest

from tests.helpers import ROOT
from tests.helpers.needs import KINDS, VARIABLE, pytest_configure

pytest_plugins = ["pytester"]

BODIES = {
    "in the test": "def test_a(): lack('rerun', 'there is none')",
    "in a fixture": "@pytest.fixture\ndef a(): lack('rerun', 'there is none')\ndef test_a(a): pass",
    "by a mark": "@pytest.mark.skipif(True, reason='rerun: there is none')\ndef test_a(): pass",
    "of a module": "pytest.importorskip('no_such_module', reason='rerun: there is none')\ndef test_a(): pass",
}


@pytest.fixture
def outcomes(pytester, monkeypatch):
    """How the one test of a file ends while REQUIRE asks for `kinds`, and what is printed."""
    pytester.makeconftest(
        "from tests.helpers.needs import pytest_make_collect_report, pytest_runtest_makereport"
    )

    def run(body: str, kinds: str) -> tuple[dict[str, int], str]:
        monkeypatch.setenv(VARIABLE, kinds)
        pytester.makepyfile(f"import pytest\nfrom tests.helpers.needs import lack\n{body}")
        result = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-rs")
        return result.parseoutcomes(), result.stdout.str() + result.stderr.str()

    return run


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_a_need_that_is_asked_for_is_a_failure_where_it_is_missing(outcomes, body):
    counts, printed = outcomes(body, "real,plot")
    assert set(counts) == {"skipped"}
    assert "rerun: there is none" in printed
    counts, printed = outcomes(body, "real, rerun")
    assert "skipped" not in counts
    assert counts.get("failed", 0) + counts.get("errors", 0) == 1
    assert "REQUIRE asks for rerun" in printed


@pytest.mark.parametrize("reason", ["", "no reason", "reruns: none", "rerun"])
def test_a_skip_without_a_kind_is_a_failure(outcomes, reason):
    counts, printed = outcomes(f"def test_a(): pytest.skip({reason!r})", "")
    assert counts == {"skipped" if reason == "rerun" else "failed": 1}
    assert ("needs a reason of a kind" in printed) == (reason != "rerun")


def test_what_passes_fails_or_is_expected_to_fail_stays_so(outcomes):
    body = "def test_a(): pass\ndef test_b(): assert 0\n@pytest.mark.xfail\ndef test_c(): assert 0"
    assert outcomes(body, "rerun")[0] == {"passed": 1, "failed": 1, "xfailed": 1}


def test_each_kind_is_listed_for_contributors():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.partition("| kind | needs |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| ([^|]+) \|", table, flags=re.MULTILINE)
    assert sorted(re.findall(r"`(\w+)`", " ".join(rows))) == sorted(KINDS)


def test_a_kind_that_there_is_not_is_named(monkeypatch):
    monkeypatch.setenv(VARIABLE, "rerun,viz")
    with pytest.raises(pytest.UsageError, match="REQUIRE: no kind viz; there are real, "):
        pytest_configure()
