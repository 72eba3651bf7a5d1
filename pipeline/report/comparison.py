"""Ours beside the paper's: one row a number, with a verdict.

reports/paper/numbers.csv has every number of the paper's tables and text. Its columns:

    place, row, column   where the number stands: a label of places.csv, and the table's own row and column
    environment, goals, metric, method   what was measured; no environment: time, which differs from run to run
    study, values        which study of params.yaml gives ours (`this|or_else_this`), and which of its samplings
                         (`sampler=euler|heun steps=3`; of several values, the mean); no study: the cell's evaluation
    mean, std, seeds     as printed; no std: the paper gives none
    maximum              the metric's largest value
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from beso import envs
from beso.errors import UserError
from pipeline import paths
from pipeline.params import Params
from pipeline.recipes import CellPaths, StudyRecipe
from pipeline.report.statistics import NORMAL, PAIRS, Estimate, of_difference, of_normal, over_seeds

PAPER = paths.REPORTS / "paper"
SMALL = 0.05  # of the largest possible value: differences beyond this matter

NOT_RUN, TIMED = "not run", "timed apart"
VERDICTS = ("better", "same", "worse", "cannot tell")
COLUMNS = ["place", "row", "column", "environment", "metric", "method", "study", "values", "goals"]
COLUMNS += ["ours", "ours_std", "ours_low", "ours_high", "seeds", "episodes", "profile", "data"]
COLUMNS += ["paper", "paper_std", "difference", "difference_low", "difference_high", "verdict"]
CELL = ["environment", "metric", "method", "goals"]


def paper_numbers() -> pd.DataFrame:
    """The paper's own numbers in its order; the columns are explained above. What is not given is an empty string."""
    texts = ["place", "row", "column", *CELL, "study", "values"]
    return pd.read_csv(PAPER / "numbers.csv", dtype=dict.fromkeys(texts, str)).fillna(dict.fromkeys(texts, ""))


def places() -> pd.DataFrame:
    """Where numbers stand in the paper, in its order.

    Columns: label (as in its source), name ("Table I"), title, what the page shows there and of what, and how the names
    of its figures begin.
    """
    return pd.read_csv(PAPER / "places.csv", dtype=str).fillna("")


def read_rows(path: Path, stage: str) -> pd.DataFrame:
    """Rows that a stage wrote.

    Raises:
        UserError: they are missing.
    """
    if not path.is_file():
        raise UserError(f"{path} is missing: run `dvc repro {stage}`")
    # Lists of tasks: a column of single tasks and gaps would be read as decimal numbers.
    return pd.read_csv(path, dtype={"tasks": str, "goal_tasks": str})


def read_episodes(root: Path, cell: CellPaths) -> pd.DataFrame:
    """The evaluation rows of one cell in a run's folder. Raises UserError as `read_rows` does."""
    return read_rows(root / cell.episodes, f"evaluate@{cell.name}")


def read_study(root: Path, study: StudyRecipe) -> pd.DataFrame:
    """The rows of one study in a run's folder. Raises UserError as `read_rows` does."""
    return read_rows(root / study.rows, f"study@{study.study}")


def rows_of(rows: pd.DataFrame, changes: dict[str, Any]) -> pd.DataFrame:
    """A study's rows of one sampling."""
    for key, value in changes.items():
        rows = rows[rows[key] == value] if value is not None else rows[rows[key].isna()]
    return rows


def source(of: str) -> str:
    """Where play data came from (`source` of their meta.json), in words that can stand in a caption."""
    return {"scripted": "scripted demonstrations made here"}.get(of, of)


class Measured(NamedTuple):
    """One of our numbers: the estimate and the rows it is of."""

    estimate: Estimate
    rows: pd.DataFrame


def compare(params: Params, sources: dict[str, str], root: Path = Path()) -> pd.DataFrame:
    """One row for each number of the paper, in its order, then one for each of ours that the paper does not have.

    Args:
        root: the run's folder.
        sources: where each environment's play data came from, in words (see `source`).

    The 95 % interval of the difference joins ours (pipeline.report.statistics) and Student's of the paper's mean and
    std; the paper's std also stands for the spread between seeds where we have one seed. A number of the paper without
    a std counts as exact.
    """
    cells = _cells(params, root)
    named = dict(places()[["label", "name"]].itertuples(index=False))
    known = {name: read_study(root, study.recipe) for name, study in params.studies.items()}
    rows, beside = [], set()
    for number in paper_numbers().itertuples():
        key = (number.environment, number.metric, number.method, number.goals)
        row = {name: getattr(number, name) for name in COLUMNS[1:9]} | {"place": named[number.place]}
        row |= {"paper": number.mean, "paper_std": number.std}
        if number.study:
            found = {name: _of_study(params, known, name, number) for name in number.study.split("|")}
            row["study"], measured = next(((n, m) for n, m in found.items() if m), (number.study, None))
        else:
            measured = cells.get(key)
        if measured is None:
            row["verdict"] = NOT_RUN if number.environment else TIMED
        else:
            beside |= set() if number.study else {key}
            row |= _ours(params, measured, sources[number.environment]) | _beside(measured.estimate, number)
        rows.append(row)
    for key, measured in cells.items():
        if key not in beside:
            rows.append(dict(zip(CELL, key, strict=True)) | _ours(params, measured, sources[key[0]]))
    table = pd.DataFrame(rows).reindex(columns=COLUMNS).replace({"": np.nan})
    return table.astype({"seeds": "Int64", "episodes": "Int64"})


def of_cells(comparison: pd.DataFrame) -> pd.DataFrame:
    """The rows of the run's cells, studies left out: one for each environment, metric, method and goal set."""
    ours = comparison[comparison["study"].isna() & comparison["ours"].notna()]
    return ours.drop_duplicates(CELL)  # the main table's row stands before one of the paper's text


Key = tuple[str, str, str, str]  # environment, metric, method, goal set


def _cells(params: Params, root: Path) -> dict[Key, Measured]:
    """Every number of the run's cells, in the order of a table."""
    found: dict[Key, Measured] = {}
    for environment in params.envs:
        played = {cell.method: read_episodes(root, cell) for cell in params.cells_in(environment)}
        for metric in envs.report(environment).METRICS:
            for method, episodes in played.items():
                for goals in params.environments[environment].evaluation.goals:
                    part = episodes[episodes["goals"] == goals]
                    found[environment, metric.name, method, goals] = Measured(over_seeds(part, metric), part)
    return found


def _of_study(params: Params, known: dict[str, pd.DataFrame], name: str, number: Any) -> Measured | None:
    """What a study of this run says of one of the paper's numbers; None if it has no such study or sampling."""
    study = params.studies.get(name)
    wanted = {key: values.split("|") for key, values in (pair.split("=") for pair in number.values.split())}
    if (
        study is None
        or (study.cell.env, study.cell.of) != (number.environment, number.method)
        or {*study.vary} != {*wanted}
    ):
        return None
    metric = next((m for m in envs.report(study.cell.env).METRICS if m.name == number.metric), None)
    samplings = [changes for changes in study.recipe.changes if _among(changes, wanted)]
    if metric is None or len(samplings) < math.prod(map(len, wanted.values())):
        return None
    rows = known[name][known[name]["goals"] == number.goals]
    rows = pd.concat([rows_of(rows, changes) for changes in samplings])
    rows = rows.groupby(PAIRS, sort=False, as_index=False)[[metric.name]].mean()
    return Measured(over_seeds(rows, metric), rows) if len(rows) else None


def _among(changes: dict[str, Any], wanted: dict[str, list[str]]) -> bool:
    return all(str(value) in wanted[key] for key, value in changes.items())


def _ours(params: Params, measured: Measured, data: str) -> dict[str, Any]:
    estimate, rows = measured
    return {
        "ours": estimate.mean,
        "ours_std": estimate.deviation,
        "ours_low": estimate.low,
        "ours_high": estimate.high,
        "seeds": rows["seed"].nunique(),
        "episodes": len(rows),
        "profile": params.profile,
        "data": data,
    }


def _beside(ours: Estimate, number: Any) -> dict[str, float | str]:
    std = 0.0 if math.isnan(number.std) else number.std
    theirs = of_normal(number.mean, std, int(number.seeds))
    if math.isnan(ours.deviation):
        low, high = of_difference(ours, Estimate(0.0, std, -NORMAL * std, NORMAL * std))
        ours = ours._replace(low=low, high=high)
    low, high = of_difference(ours, theirs)
    return {
        "difference": ours.mean - theirs.mean,
        "difference_low": low,
        "difference_high": high,
        "verdict": verdict(low, high, number.maximum),
    }


def verdict(low: float, high: float, maximum: float) -> str:
    """In one word, or two, what the 95 % interval of a difference says.

    "better" or "worse" if the interval leaves out zero; else "same" if all of it is small, or "cannot tell".
    """
    if low > 0 or high < 0:
        return "better" if low > 0 else "worse"
    return "same" if max(-low, high) <= SMALL * maximum else "cannot tell"
