"""LaTeX tables from comparison and data, through jinja2 templates."""

import math
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from beso import envs
from pipeline.params import Params
from pipeline.report.comparison import CELL, of_cells
from pipeline.report.names import Names

TEMPLATES = Path("reports/templates")


def render(template: str, values: dict[str, Any]) -> str:
    """The LaTeX text of a template, whose marks are \\VAR{...} and \\BLOCK{...}."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        block_start_string=r"\BLOCK{",
        block_end_string="}",
        variable_start_string=r"\VAR{",
        variable_end_string="}",
        comment_start_string=r"\#{",
        comment_end_string="}",
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(values)


def main_methods(params: Params) -> list[str]:
    """Columns of the main table: the methods of all environments, without variants, in the parameters' order."""
    run = {cell.method for cell in params.cells.values() if cell.method == cell.of}
    return [method for method in params.labels if method in run]


def main_rows(params: Params, comparison: pd.DataFrame, names: Names) -> list[dict[str, Any]]:
    """Rows of the main table: environment, metric, whose numbers, and a cell `mean (+- std)` a method.

    The paper's numbers stand there also for cells that this run does not have.
    """
    rows, ours = [], of_cells(comparison)
    theirs = comparison[comparison["study"].isna() & comparison["paper"].notna()]
    for environment in params.envs:
        goal_sets = params.environments[environment].evaluation.goals
        for metric in envs.report(environment).METRICS:
            for whose in [*goal_sets, "paper"]:
                numbers, name = (theirs, "paper") if whose == "paper" else (ours, "ours")
                goals = goal_sets[0] if whose == "paper" else whose
                cells = []
                for method in main_methods(params):
                    wanted = dict(zip(CELL, (environment, metric.name, method, goals), strict=True))
                    row = numbers[(numbers[CELL] == pd.Series(wanted)).all(axis=1)]
                    cells.append(tuple(row[[name, f"{name}_std"]].iloc[0]) if len(row) else (math.nan, math.nan))
                rows.append(
                    {
                        "environment": names.environments[environment],
                        "metric": metric.label,
                        "whose": "paper" if whose == "paper" else f"ours, {names.goals(environment, whose)}",
                        "first": whose == goal_sets[0],
                        "cells": cells,
                    }
                )
    return rows


def number(value: float | None, decimals: int = 2) -> str:
    """A score for a table; a dash where there is none."""
    if value is None or math.isnan(value):
        return "--"
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0: no minus before a zero


def significant(value: float | None, digits: int = 4) -> str:
    """Any quantity for a table: whole numbers as they are, others with some significant digits; a dash for none."""
    if value is None or math.isnan(value):
        return "--"
    if float(value).is_integer():
        return f"{int(value):,}"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{value:,.{max(decimals, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
