"""The paper's tables, rows by columns, with ours beside the paper's; and text from jinja2 templates."""

import math
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd

from beso import envs
from pipeline.params import Params
from pipeline.report.comparison import CELL, NOT_RUN

TEMPLATES = Path("reports/templates")
LATEX: dict[str, Any] = {
    "block_start_string": r"\BLOCK{",
    "block_end_string": "}",
    "variable_start_string": r"\VAR{",
    "variable_end_string": "}",
    "comment_start_string": r"\#{",
    "comment_end_string": "}",
}


def render(template: str, values: dict[str, Any]) -> str:
    """The text of a template. Marks of LaTeX templates are \\VAR{...} and \\BLOCK{...}."""
    latex, html = template.endswith(".tex.j2"), template.endswith(".html.j2")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        autoescape=html,
        keep_trailing_newline=not html,
        **(LATEX if latex else {}),
    )
    return environment.get_template(template).render(values)


def main_methods(params: Params) -> list[str]:
    """Columns of the main table: the methods of all environments, without variants, in the parameters' order."""
    run = {cell.method for cell in params.cells.values() if cell.method == cell.of}
    return [method for method in params.labels if method in run]


def seeds(params: Params, environment: str) -> str:
    """How many seeds the methods of an environment have: `3 seeds`, or `1 to 3 seeds` where it is not one number."""
    counts = [len(cell.train.seeds) for cell in params.cells_in(environment)]
    least, most = min(counts), max(counts)
    if least < most:
        return f"{least} to {most} seeds"
    return f"{most} seed" + ("s" if most > 1 else "")


def main_rows(params: Params, comparison: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of the main table: environment, metric, whose numbers, and a cell `mean (+- std)` a method.

    The paper's numbers stand there also for cells that this run does not have. Where it has none of cells, the first of
    a study stands for them.
    """
    of_cells = comparison[comparison["study"].isna()].drop_duplicates(CELL).set_index(CELL)
    stated = comparison[comparison["paper"].notna()].sort_values("study", key=pd.Series.notna, kind="stable")
    numbers = {"ours": of_cells, "paper": stated.drop_duplicates(CELL).set_index(CELL)}
    rows = []
    for env in params.envs:
        goal_sets, room = params.environments[env].evaluation.goals, envs.report(env)
        for metric in room.METRICS:
            lines = {}
            for of, table in numbers.items():
                for goals in goal_sets:
                    keys = [(env, metric.name, method, goals) for method in main_methods(params)]
                    cells = table.reindex(keys)[[of, f"{of}_std"]].to_numpy(dtype=float)
                    if of == "ours" or not np.isnan(cells).all():
                        lines[of, goals] = cells.tolist()
            alone = sum(of == "paper" for of, _ in lines) == 1
            for i, ((of, goals), cells) in enumerate(lines.items()):
                whose = of if of == "paper" and alone else f"{of}, {room.GOAL_LABELS[goals]}"
                row = {"environment": room.LABEL, "metric": metric.label, "whose": whose}
                rows.append(row | {"cells": cells, "first": i == 0})
    return rows


def sheets(comparison: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """The paper's tables that have numbers, by the paper's name. Of each table:

    columns: heads of the columns.
    lines: a head, then a row of the comparison for each column; None where the table has no number. Each of our other
        goal sets has a line of its own.
    studies, environments: those that our numbers come from.
    missing: heads of the rows that this run has no numbers for.
    wanted: the cells and studies that would give them.
    """
    found = {}
    for name, part in comparison.groupby("place", sort=False):
        columns, lines = part["column"].unique(), []
        for head, of_row in part.groupby("row", sort=False):
            cells = {row.column: row for row in of_row.itertuples()}
            line = [cells.get(column) for column in columns]
            lines += [(head, line), *_other_goals(head, line, of_row, comparison[comparison["place"].isna()])]
        ran = part[part["ours"].notna()]
        missing = part[part.groupby("row")["verdict"].transform(lambda verdicts: (verdicts == NOT_RUN).all())]
        found[name] = {
            "columns": columns.tolist(),
            "lines": lines,
            "studies": ran["study"].dropna().unique().tolist(),
            "environments": ran["environment"].dropna().unique().tolist(),
            "missing": missing["row"].unique().tolist(),
            "wanted": missing["study"]
            .fillna(missing["environment"] + "-" + missing["method"])
            .str.split("|")
            .explode(),
        }
    return found


def _other_goals(head: str, line: list[Any], of_row: pd.DataFrame, others: pd.DataFrame) -> list[tuple[str, list[Any]]]:
    """The same line for each goal set that the paper does not have, where its columns are methods."""
    measured = ["environment", "metric"]
    if of_row["study"].notna().any() or len(of_row[measured].drop_duplicates()) > 1:
        return []
    lines = []
    for (environment, goals), part in others.merge(of_row[measured].drop_duplicates()).groupby(
        ["environment", "goals"], sort=False
    ):
        cells = {row.method: row for row in part.itertuples()}
        shown = [cells.get(cell.method) if cell else None for cell in line]
        if any(shown):  # not of a variant alone
            lines.append((f"{head}, {envs.report(environment).GOAL_LABELS[goals]}", shown))
    return lines


def number(value: float | None, decimals: int = 2) -> str:
    """A score for a table; a dash where there is none."""
    if value is None or math.isnan(value):
        return "--"
    return f"{value:z.{decimals}f}"  # z: no minus before a zero


def significant(value: float | None, digits: int = 4) -> str:
    """Any quantity for a table: whole numbers as they are, others with some significant digits; a dash for none."""
    if value is None or math.isnan(value):
        return "--"
    if float(value).is_integer():
        return f"{int(value):,}"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{value:,.{max(decimals, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
