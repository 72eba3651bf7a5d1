"""LaTeX tables from comparison and data, through jinja2 templates."""

import math
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from pipeline import names
from pipeline.params import Params

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


def main_rows(params: Params, comparison: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of the main table: environment, metric, whose numbers, and a cell `mean (+- std)` a method."""
    rows = []
    for environment in params.grid.envs:
        for metric in names.METRICS:
            part = comparison[(comparison["environment"] == environment) & (comparison["metric"] == metric)]
            for whose in [*params.evaluation.goals, "paper"]:
                cells = []
                for method in params.grid.methods:
                    row = part[
                        (part["method"] == method) & (part["goals"] == ("training" if whose == "paper" else whose))
                    ]
                    columns = ("paper", "paper_std") if whose == "paper" else ("ours", "ours_std")
                    cells.append(tuple(row[list(columns)].iloc[0]) if len(row) else (math.nan, math.nan))
                rows.append(
                    {
                        "environment": names.ENVIRONMENTS[environment],
                        "metric": names.METRICS[metric],
                        "whose": "paper" if whose == "paper" else f"ours, {names.GOALS[whose]}",
                        "cells": cells,
                    }
                )
    return rows


def number(value: float | None, decimals: int = 2) -> str:
    """A number for a table; a dash where there is none."""
    if value is None or math.isnan(value):
        return "--"
    if float(value).is_integer() and abs(value) >= 10:
        return f"{int(value):,}"
    return f"{value:.{decimals}f}"
