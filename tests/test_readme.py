"""The README stays short; what it and the pages in docs/ link to is there."""

import re
from pathlib import Path

import pandas as pd
import pytest

from pipeline import profile
from pipeline.cli import cli
from pipeline.report import comparison
from pipeline.tools import readme

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LONGEST = 30  # words of a sentence


def prose():
    """Paragraphs and items, without code, tables, pictures and headings."""
    text = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.startswith(("    ", "|", "#", "<!--", "!["))]
    paragraphs = re.split(r"\n\s*\n|\n(?=- )", "\n".join(lines))
    return [re.sub(r"\]\([^)]*\)", "]", " ".join(paragraph.split())) for paragraph in paragraphs]


def sentences():
    return [sentence for paragraph in prose() for sentence in re.split(r"(?<=[.?!:;])\s+(?=[\[`*A-Z])", paragraph)]


def test_it_is_read_in_a_few_minutes():
    assert len(README.splitlines()) <= 150
    assert len(README.split()) <= 1600


def test_sentences_are_short():
    found = sentences()
    assert len(found) > 40
    assert [sentence for sentence in found if len(sentence.split()) > LONGEST] == []


def anchors(path):
    """What GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    for link in re.findall(r"\]\(([^)]+)\)", path.read_text()):
        name, _, anchor = link.partition("#")
        if "://" not in link:
            target = path.parent / name if name else path
            assert target.exists(), link
            assert not anchor or anchor in anchors(target), link


def test_commands_are_there():
    commands = set(re.findall(r"\bbeso ([a-z]+)\b(?= )", "\n".join(re.findall(r"^    beso .*", README, flags=re.M))))
    assert commands
    assert commands <= {*cli.commands}
    targets = set(re.findall(r"^    make (\w+)", README, flags=re.M))
    assert targets <= set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.M))


@pytest.mark.parametrize("name", profile.names())
def test_the_parameter_that_it_changes_stands_on_one_line_of_every_profile(name):
    ((old, new),) = re.findall(r"sed -i 's/(.*?)/(.*?)/' params\.yaml", README)
    before = profile.render(name).splitlines()
    after = [re.sub(old, new, line) for line in before]
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


def test_its_table_has_the_papers_scores_and_each_runs(monkeypatch):
    archive = pd.read_csv(ROOT / "reports/published/cpu/comparison.csv")
    lines = [
        line.strip("| ").split(" | ") for line in readme.results(profile.load("cpu"), {"run": archive}).splitlines()
    ]
    assert lines[0][1:] == ["GCBC", "C-IBC", "LMP", "RIL", "C-BeT", "CX-Diff", "C-BESO", "CFG-BESO"]
    assert lines[2][:4] == ["Block-Push, result (at most 1)", "paper", "0.13", "0.29"]
    scores = archive.query("place == 'Table I' and environment == 'block_push' and metric == 'result'")["ours"]
    assert lines[3] == ["run", *(f"{score:.2f}" for score in scores)]
    paper = [line for line in lines if line[0].startswith("CALVIN, two")]
    assert paper == [["CALVIN, two tasks, success (at most 1)", "paper", *["-"] * 6, "0.79", "-"]]
    numbers = comparison.paper_numbers()
    monkeypatch.setattr(readme, "paper_numbers", lambda: numbers[numbers["environment"] != "calvin"])
    lines = readme.results(profile.load("cpu"), {"run": archive})
    assert "Kitchen" in lines
    assert "CALVIN" not in lines
    assert readme.BEGIN in README
    assert readme.END in README
