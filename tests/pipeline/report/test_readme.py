"""README.md of a run, made from the rows of a committed archive."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.params import PATH, load
from pipeline.report import readme
from pipeline.report.comparison import of_cells
from pipeline.report.gather import gather
from pipeline.report.tables import seeds
from pipeline.tools.archive import held, parts, restricted

ROOT = Path(__file__).parents[3]
ARCHIVE = Path("reports/published/gpu")


@pytest.fixture(scope="module")
def values():
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        params = load(ARCHIVE / PATH)
        found = gather(restricted(params, held(ARCHIVE, parts(params))), ARCHIVE)
        return found | {"captions": {"scores_kitchen": "Scores in a sentence.", "one_more": "Of no part."}}


@pytest.fixture
def page(values, monkeypatch):
    monkeypatch.chdir(ROOT)
    return readme.render(values)


def rows(page):
    """Cells of the tables' lines."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("|")]


def test_main_table_has_ours_and_the_papers(values, page):
    lines = {tuple(row[1:3]): row for row in rows(page) if len(row) == 4 and row[0] == "Block-Push"}
    assert page.startswith("# Results of profile gpu, beside the paper's\n")
    ours = of_cells(values["comparison"]).set_index(["environment", "metric", "goals"])["ours"]
    for metric in ("reward", "result"):
        row = lines[metric.capitalize(), "ours, training goals"]
        assert row[3] == f"{ours['block_push', metric, 'training']:.2f}"
    assert ["", "", "paper", "0.93 ± 0.02"] in rows(page)
    assert page.count("scripted demonstrations made here") == 2, "what the play data are, for each environment"


def test_tables_are_whole_and_figures_are_shown(page):
    width = 0
    for line in page.splitlines():
        width = line.count("|") if line.startswith("|") and not width else width * line.startswith("|")
        assert line.count("|") == width, line
    assert "![scores kitchen](figures/scores_kitchen.png)\n\nScores in a sentence.\n" in page
    assert "- [one more](figures/one_more.png): Of no part.\n" in page
    assert "\n\n\n" not in page


@pytest.mark.parametrize(
    "folder", [Path("reports"), *sorted(p.relative_to(ROOT) for p in (ROOT / "reports/published").iterdir())], ids=str
)
def test_committed_pages_link_to_what_is_there(folder):
    links = re.findall(r"\]\(([^)]+)\)", (ROOT / folder / "README.md").read_text())
    assert links
    assert [link for link in links if not (ROOT / folder / link).exists()] == []


def test_number_of_seeds_may_differ_between_methods(values, page):
    params = values["params"]
    cells = params.cells_in("kitchen")
    many = replace(cells[0], train=replace(cells[0].train, seeds=(1, 2, 3)))
    both = replace(params, cells={"a": many, "b": replace(many, train=replace(many.train, seeds=(1,)))})
    assert seeds(params, "kitchen") == "1 seed"
    assert "| 1 seed | 100 |" in page
    assert seeds(replace(params, cells={"a": many}), "kitchen") == "3 seeds"
    assert seeds(both, "kitchen") == "1 to 3 seeds"
