"""The paper's tables as the paper has them, rows by columns, with ours in every cell beside the paper's number."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import pandas as pd

from pipeline import profile
from pipeline.params import Params
from pipeline.report.comparison import NOT_RUN
from pipeline.report.names import Names


class Line(NamedTuple):
    """One row of a sheet: its head, and a row of the comparison a column (None where the table has no number)."""

    head: str
    cells: Sequence[Any]


class Sheet(NamedTuple):
    """One of the paper's tables.

    Attributes:
        columns: their heads.
        lines: all of its rows, and ours for other goal sets.
        studies, environments: those that ours are of.
        missing: heads of the rows of which this run has nothing.
        wanted: the cells and studies that those are of.
    """

    columns: list[str]
    lines: list[Line]
    studies: list[str]
    environments: list[str]
    missing: list[str]
    wanted: set[str]


def sheets(comparison: pd.DataFrame, names: Names) -> dict[str, Sheet]:
    """By the paper's name of each table that has numbers. Our other goal sets get lines of their own."""
    found = {}
    others = comparison[comparison["place"].isna()]
    for name, part in comparison[comparison["place"].notna()].groupby("place", sort=False):
        columns = list(dict.fromkeys(part["column"]))
        ours = part[part["ours"].notna()]
        studies, environments = (ours[column].dropna().unique().tolist() for column in ("study", "environment"))
        sheet = found[name] = Sheet(columns, [], studies, environments, [], set())
        for head, of_row in part.groupby("row", sort=False):
            cells = {row.column: row for row in of_row.itertuples()}
            line = Line(head, [cells.get(column) for column in columns])
            sheet.lines.extend([line, *_other_goals(line, others, names)])
            if (of_row["verdict"] == NOT_RUN).all():
                sheet.missing.append(head)
                sheet.wanted.update(*map(_sources, cells.values()))
    return found


def _sources(row: Any) -> list[str]:
    """The cell or studies, as params.yaml names them, that a row of the comparison is or would be of."""
    return [f"{row.environment}-{row.method}"] if pd.isna(row.study) else row.study.split("|")


def _other_goals(line: Line, others: pd.DataFrame, names: Names) -> list[Line]:
    """The same line for each goal set that the paper does not have, where its columns are methods."""
    first = next(cell for cell in line.cells if cell)
    if not pd.isna(first.study) or len({(cell.environment, cell.metric) for cell in line.cells if cell}) > 1:
        return []
    others = others[(others["environment"] == first.environment) & (others["metric"] == first.metric)]
    lines = []
    for goals, part in others.groupby("goals", sort=False):
        cells = {row.method: row for row in part.itertuples()}
        shown = [cells.get(cell.method) if cell else None for cell in line.cells]
        if any(shown):  # not of a variant alone
            lines.append(Line(f"{line.head}, {names.goals(first.environment, goals)}", shown))
    return lines


def other_profiles(params: Params) -> dict[str, set[str]]:
    """What each other profile runs: its environments, cells and studies, by the names that params.yaml gives them."""
    found = {}
    for path in sorted(profile.FOLDER.iterdir()):
        if path.is_dir() and path.name != params.profile:
            other = profile.load(path.name)
            found[path.name] = {*other.envs, *other.cells, *other.studies}
    return found
