import re
import subprocess

import tracker
from scripts.check_phrases import PHRASES, found, main, read_phrases
from tests.docs.samples import PAGES
from tests.helpers import ROOT


def test_a_phrase_is_found_across_lines_with_its_line_and_plainer_words(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text("All is well.\nA run that was broken\noff is here.\n", encoding="utf-8")
    assert main([str(tmp_path)]) == 1
    assert capsys.readouterr().out == f"{page}:2: broken off ==> interrupted\n"
    page.write_text("A run that was interrupted.\n", encoding="utf-8")
    assert main([str(page)]) == 0
    # Phrases that read as translated are listed, and words have plainer ones.
    phrases = read_phrases(PHRASES.read_text(encoding="utf-8"))
    for text in ("It tells of cameras", "nobody knows", "lets expect", "did not teach"):
        assert list(found(text, phrases)), text
    words = (ROOT / "docs" / "style" / "words.txt").read_text(encoding="utf-8")
    assert all(re.fullmatch(r"[a-z']+->[a-z', ]+", line) for line in words.splitlines())


def test_the_changelog_is_of_what_is_unreleased_and_of_tags_and_each_begins_with_what_users_get():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.split(r"^## \[", text, flags=re.MULTILINE)[1:]
    for section in sections:
        assert re.match(r"[\w.]+\].*\n\n### For users\n", section), section.partition("\n")[0]
    first, *versions = (section.partition("]")[0] for section in sections)
    assert first == "Unreleased"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in versions)
    assert len(set(versions)) == len(versions)
    listed = subprocess.run(["git", "tag"], cwd=ROOT, capture_output=True, text=True, check=False)
    tags = set(listed.stdout.split())
    # A copy without history has none.
    assert not tags or {f"v{version}" for version in versions} <= tags


def test_each_page_states_its_question_at_its_top_and_the_one_of_answers_explains_every_status():
    for page in set(PAGES) - {"README", "docs/index"}:
        assert "?" in next(line for line in PAGES[page].splitlines()[1:] if line.strip()), page
    explained = re.findall(r"^\| `([a-z_]+)` \|", PAGES["docs/answers"], flags=re.MULTILINE)
    assert explained == [status.value for status in tracker.Status]


SYMPTOMS = (
    "no pose", "colours", "red blue swapped", "swapped cameras", "camera moved", "blurred images",
    "float table", "12-bit png", "lags", "first run slow", "images late", "black frozen", "pose jumps",
    "extra missing",
)  # fmt: skip


def test_a_section_on_troubleshooting_has_all_words_of_a_symptom():
    sections = re.split("^##+ ", PAGES["docs/troubleshooting"].lower(), flags=re.MULTILINE)
    for symptom in SYMPTOMS:
        assert any(all(word in section for word in symptom.split()) for section in sections), symptom


def test_every_link_of_what_is_no_page_leads_somewhere():
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "benchmarks" / "tools.md"):
        for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert "://" in target or (page.parent / target).exists(), f"{page.name}: {target}"


def test_readme_and_pages_are_short():
    words = {
        name: sum(not re.fullmatch(r"[|:-]+", word) for word in text.split())  # but for rules of tables
        for name, text in PAGES.items()
    }
    assert words.pop("README") <= 500
    assert sum(words.values()) <= 16_000
