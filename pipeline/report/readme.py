"""README.md beside the tables, as GitHub shows it."""

from typing import Any

from pipeline.report import tables
from pipeline.report.comparison import VERDICTS, paper_numbers
from pipeline.report.page import BEYOND, REST, Picture, arrange


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
