"""README.md beside the tables, as GitHub shows it; and the table of results in the project's own README.

`python -m pipeline.report.readme` renews the latter from the comparisons of the committed run and of the archives.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from beso.files import write_text
from pipeline import paths
from pipeline.params import Params, load
from pipeline.report import tables
from pipeline.report.comparison import VERDICTS, paper_numbers
from pipeline.report.page import BEYOND, REST, Picture, arrange

README = Path("README.md")
BEGIN, END = "<!-- results -->\n", "<!-- end of results -->\n"
SHOWN = (  # label, environment, metric, goals
    ("Block push, result of 1", "block_push", "result", "training"),
    ("Kitchen, result of 4", "kitchen", "result", "training"),
    ("CALVIN, one task", "calvin", "success", "single_tasks"),
    ("CALVIN, two tasks", "calvin", "success", "two_tasks"),
)


def render(values: dict[str, Any]) -> str:
    """The page's Markdown.

    Args:
        values: from pipeline.report.gather.gather, with the `captions` of the figures by the names of their files.
    """
    comparison = values["comparison"]
    verdicts = comparison["verdict"].value_counts()
    pictures = [Picture(name, caption, None) for name, caption in values["captions"].items()]
    figures = arrange(pictures, {place.name: place.figures.split() for place in values["places"]} | BEYOND)
    further = [part for part in (*BEYOND, REST) if part != "overview"]
    shown = {
        "count": len(paper_numbers()),
        "tally": {verdict: int(verdicts.get(verdict, 0)) for verdict in VERDICTS},
        "ran": {*comparison.loc[comparison["ours"].notna(), "place"]},
        "figures": figures,
        "others": [figure for part in further for figure in figures[part]],
    }
    return tables.render("README.md.j2", values | shown)


def results(params: Params, runs: Mapping[str, pd.DataFrame]) -> str:
    """A Markdown table of the main scores: the paper's row, then one for each run that has any.

    Args:
        params: for the methods and their labels.
        runs: the runs' comparisons, by the name that the table gives them.
    """
    methods, paper = tables.main_methods(params), paper_numbers().rename(columns={"mean": "paper"})
    lines = ["| | run | " + " | ".join(params.labels[method] for method in methods) + " |"]
    lines.append("|---|---|" + "---|" * len(methods))
    for label, env, metric, goals in SHOWN:
        for name, column, table in [("paper", "paper", paper), *((name, "ours", run) for name, run in runs.items())]:
            at = (table["environment"] == env) & (table["metric"] == metric) & (table["goals"] == goals)
            rows = table[at & table[column].notna() & ((column == "paper") | table["study"].isna())]
            numbers = rows.drop_duplicates("method").set_index("method")[column].reindex(methods)
            if numbers.notna().any():
                told = " | ".join(tables.number(value).replace("--", "-") for value in numbers)
                lines.append(f"| {label if name == 'paper' else ''} | {name} | {told} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Put the table into the project's README."""
    params = load()
    folders = {path.parent.name: path.parent for path in sorted((paths.REPORTS / "published").glob("*/comparison.csv"))}
    folders = {**dict(reversed(folders.items())), params.profile: paths.REPORTS}
    runs = {name: pd.read_csv(folder / "comparison.csv") for name, folder in folders.items()}
    before, _, rest = README.read_text(encoding="utf-8").partition(BEGIN)
    write_text(README, before + BEGIN + results(params, runs) + END + rest.partition(END)[2])


if __name__ == "__main__":
    main()
