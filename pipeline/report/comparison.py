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
from typing import Any

import numpy as np
import pandas as pd

from beso import envs
from beso.envs.protocol import Metric
from pipeline import paths
from pipeline.params import Params
from pipeline.report.statistics import NORMAL, PAIRS, Estimate, of_difference, of_normal, over_seeds

PAPER = paths.REPORTS / "paper"
SMALL = 0.05  # of the largest possible value: differences beyond this matter

NOT_RUN, TIMED = "not run", "timed apart"
VERDICTS = ("better", "same", "worse", "cannot tell")
COLUMNS = ["place", "row", "column", "environment", "metric", "method", "study", "values", "goals"]
OURS = ["ours", "ours_std", "ours_low", "ours_high"]
COLUMNS += [*OURS, "seeds", "episodes", "profile", "data"]
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


def rows_of(rows: pd.DataFrame, changes: dict[str, Any]) -> pd.DataFrame:
    """A study's rows of one sampling."""
    for key, value in changes.items():
        rows = rows[rows[key] == value] if value is not None else rows[rows[key].isna()]
    return rows


def compare(
    params: Params, episodes: dict[str, pd.DataFrame], studies: dict[str, pd.DataFrame], sources: dict[str, str]
) -> pd.DataFrame:
    """One row for each number of the paper, in its order, then one for each of ours that the paper does not have.

    Args:
        episodes, studies: the rows of each cell and of each study.
        sources: where each environment's play data came from, in words.

    The 95 % interval of the difference joins ours (pipeline.report.statistics) and Student's of the paper's mean and
    std; the paper's std also stands for the spread between seeds where we have one seed. A number of the paper without
    a std counts as exact.
    """
    cells, numbers = _cells(params, episodes), paper_numbers()
    named = places().set_index("label")["name"]
    rows = []
    for number in numbers.itertuples():
        row = {name: getattr(number, name) for name in COLUMNS[1:9]} | {"place": named[number.place]}
        row |= {"paper": number.mean, "paper_std": number.std}
        if number.study:
            found = {name: _of_study(params, studies, name, number) for name in number.study.split("|")}
            row["study"], ours = next(((name, of) for name, of in found.items() if of), (number.study, None))
        else:
            ours = cells.get(tuple(row[name] for name in CELL))
        row |= ours | _beside(ours, number) if ours else {"verdict": NOT_RUN if number.environment else TIMED}
        rows.append(row)
    beside = {*numbers.loc[numbers["study"] == "", CELL].itertuples(index=False, name=None)}
    rows += [dict(zip(CELL, key, strict=True)) | cells[key] for key in cells if key not in beside]
    table = pd.DataFrame(rows).reindex(columns=COLUMNS).replace({"": np.nan})
    table[["profile", "data"]] = table[["profile", "data"]].astype(object)
    table.loc[table["ours"].notna(), "profile"] = params.profile
    table["data"] = table["environment"].map(sources).where(table["ours"].notna())
    return table.astype({"seeds": "Int64", "episodes": "Int64"})


def of_cells(comparison: pd.DataFrame) -> pd.DataFrame:
    """The rows of the run's cells, studies left out: one for each environment, metric, method and goal set."""
    ours = comparison[comparison["study"].isna() & comparison["ours"].notna()]
    return ours.drop_duplicates(CELL)  # the main table's row stands before one of the paper's text


def _cells(params: Params, episodes: dict[str, pd.DataFrame]) -> dict[tuple[str, ...], dict[str, Any]]:
    """Every number of the run's cells by environment, metric, method and goal set, in the order of a table."""
    return {
        (env, metric.name, cell.method, goals): _ours(episodes[cell.name].query("goals == @goals"), metric)
        for env in params.envs
        for metric in envs.report(env).METRICS
        for cell in params.cells_in(env)
        for goals in params.environments[env].evaluation.goals
    }


def _of_study(params: Params, rows: dict[str, pd.DataFrame], name: str, number: Any) -> dict[str, Any] | None:
    """What a study of this run says of one of the paper's numbers; None if it has no such study or sampling."""
    wanted = {key: values.split("|") for key, values in (pair.split("=") for pair in number.values.split())}
    study = params.studies.get(name)
    asked = (number.environment, number.method, {*wanted})
    if study is None or (study.env, study.of, {*study.varied}) != asked:
        return None
    metric = next((m for m in envs.report(study.env).METRICS if m.name == number.metric), None)
    samplings = [
        changes for changes in study.changes if all(str(value) in wanted[key] for key, value in changes.items())
    ]
    if metric is None or len(samplings) < math.prod(map(len, wanted.values())):
        return None
    played = pd.concat([rows_of(rows[name], {**changes, "goals": number.goals}) for changes in samplings])
    return (
        _ours(played.groupby(PAIRS, sort=False, as_index=False)[[metric.name]].mean(), metric) if len(played) else None
    )


def _ours(rows: pd.DataFrame, metric: Metric) -> dict[str, Any]:
    counts = {"seeds": rows["seed"].nunique(), "episodes": len(rows)}
    return dict(zip(OURS, over_seeds(rows, metric), strict=True)) | counts


def _beside(row: dict[str, Any], number: Any) -> dict[str, float | str]:
    """The columns that ours and the paper's give together."""
    std, ours = 0.0 if math.isnan(number.std) else number.std, Estimate(*(row[name] for name in OURS))
    theirs = of_normal(number.mean, std, int(number.seeds))
    if math.isnan(ours.deviation):
        low, high = of_difference(ours, Estimate(0.0, std, -NORMAL * std, NORMAL * std))
        ours = ours._replace(low=low, high=high)
    low, high = of_difference(ours, theirs)
    change, told = ours.mean - theirs.mean, verdict(low, high, number.maximum)
    return {"difference": change, "difference_low": low, "difference_high": high, "verdict": told}


def verdict(low: float, high: float, maximum: float) -> str:
    """In one word, or two, what the 95 % interval of a difference says.

    "better" or "worse" if the interval leaves out zero; else "same" if all of it is small, or "cannot tell".
    """
    if low > 0 or high < 0:
        return "better" if low > 0 else "worse"
    return "same" if max(-low, high) <= SMALL * maximum else "cannot tell"
