"""Ours beside the paper's: one row a number, with a verdict."""

import math
from pathlib import Path

import pandas as pd

from beso.data import play
from beso.data.spec import spec
from beso.errors import UserError
from pipeline import names, paths
from pipeline.params import Params
from pipeline.statistics import Estimate, over_seeds

PAPER = Path(__file__).with_name("paper.csv")
SMALL = 0.05  # of the largest possible value: differences beyond this matter


def paper_numbers() -> pd.DataFrame:
    """The paper's own numbers: table (its label), environment, metric, method, mean, std, seeds, maximum."""
    return pd.read_csv(PAPER)


def read_episodes(environment: str, method: str) -> pd.DataFrame:
    """The evaluation rows of one cell.

    Raises:
        UserError: they are missing.
    """
    path = paths.episodes(environment, method)
    if not path.is_file():
        raise UserError(f"{path} is missing: run `dvc repro evaluate@{environment}-{method}`")
    return pd.read_csv(path)


def source(dataset: play.PlayDataset) -> str:
    """Where play data came from, in words that can stand in a caption."""
    return {"scripted": "scripted demonstrations made here"}.get(dataset.meta["source"], dataset.meta["source"])


def compare(params: Params) -> pd.DataFrame:
    """One row for each environment, metric, method and goal set of the grid.

    The paper's numbers stand beside results over training goals, which are its protocol; rows over held-out goals have
    none. The standard error of the difference joins ours (pipeline.statistics) and the paper's std / sqrt(seeds); the
    paper's std also stands for the spread between seeds where we have one seed.
    """
    paper = paper_numbers().set_index(["environment", "metric", "method"])
    rows = []
    for environment in params.grid.envs:
        data = source(play.load(paths.play(environment), spec(environment)))
        for metric in names.METRICS:
            for method in params.grid.methods:
                episodes = read_episodes(environment, method)
                theirs = paper.loc[(environment, metric, method)]
                for goals in params.evaluation.goals:
                    part = episodes[episodes["goals"] == goals]
                    ours = over_seeds(part, metric, deviation_of_one=theirs["std"])
                    row = {
                        "environment": environment,
                        "metric": metric,
                        "method": method,
                        "goals": goals,
                        "ours": ours.mean,
                        "ours_std": ours.deviation,
                        "ours_standard_error": ours.error,
                        "seeds": part["seed"].nunique(),
                        "episodes": len(part),
                        "profile": params.profile,
                        "data": data,
                    }
                    rows.append(row | (_beside(ours, theirs) if goals == "training" else {}))
    return pd.DataFrame(rows)


def _beside(ours: Estimate, theirs: pd.Series) -> dict[str, float | str]:
    difference = ours.mean - theirs["mean"]
    error = math.hypot(ours.error, theirs["std"] / math.sqrt(theirs["seeds"]))
    return {
        "paper_table": theirs["table"],
        "paper": theirs["mean"],
        "paper_std": theirs["std"],
        "difference": difference,
        "standard_error": error,
        "verdict": verdict(difference, ours.factor * error, theirs["maximum"]),
    }


def verdict(difference: float, half_width: float, maximum: float) -> str:
    """In one word, or two, what a difference with a 95 % interval of +- half_width says.

    "better" or "worse" if the interval leaves out zero; else "same" if all of it is small, or "cannot tell".
    """
    if abs(difference) > half_width:
        return "better" if difference > 0 else "worse"
    return "same" if abs(difference) + half_width <= SMALL * maximum else "cannot tell"
