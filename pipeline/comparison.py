"""Ours beside the paper's: one row a number, with a verdict."""

import math
from pathlib import Path

import pandas as pd

from beso.data import play
from beso.data.spec import spec
from beso.errors import UserError
from pipeline import paths
from pipeline.params import Params
from pipeline.statistics import over_seeds

PAPER = Path(__file__).with_name("paper.csv")
METRICS = ("reward", "result")
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
    none. The standard error of the difference joins ours over seeds (over episodes if there is one seed) and the
    paper's std / sqrt(seeds).
    """
    paper = paper_numbers().set_index(["environment", "metric", "method"])
    rows = []
    for environment in params.grid.envs:
        data = source(play.load(paths.play(environment), spec(environment)))
        for metric in METRICS:
            for method in params.grid.methods:
                episodes = read_episodes(environment, method)
                for goals in params.evaluation.goals:
                    part = episodes[episodes["goals"] == goals]
                    mean, std, error = over_seeds(part, metric)
                    row = {
                        **{"environment": environment, "metric": metric, "method": method, "goals": goals},
                        **{"ours": mean, "ours_std": std, "ours_standard_error": error},
                        **{"seeds": part["seed"].nunique(), "episodes": len(part)},
                        **{"profile": params.profile, "data": data},
                    }
                    if goals == "training":
                        row |= _beside(mean, error, paper.loc[(environment, metric, method)])
                    rows.append(row)
    return pd.DataFrame(rows)


def _beside(mean: float, error: float, paper: pd.Series) -> dict[str, float | str]:
    difference = mean - paper["mean"]
    joint = math.hypot(error, paper["std"] / math.sqrt(paper["seeds"]))
    return {
        "paper_table": paper["table"],
        "paper": paper["mean"],
        "paper_std": paper["std"],
        "difference": difference,
        "standard_error": joint,
        "verdict": verdict(difference, joint, paper["maximum"]),
    }


def verdict(difference: float, standard_error: float, maximum: float) -> str:
    """ "better" or "worse" beyond two standard errors; within them "same" if they are small, else "cannot tell"."""
    if math.isnan(standard_error):
        return "cannot tell"
    if abs(difference) > 2 * standard_error:
        return "better" if difference > 0 else "worse"
    return "same" if 2 * standard_error <= SMALL * maximum else "cannot tell"
