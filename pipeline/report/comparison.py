"""Ours beside the paper's: one row a number, with a verdict."""

import math
from pathlib import Path

import pandas as pd

from beso import envs
from beso.data import play
from beso.errors import UserError
from pipeline import paths
from pipeline.params import Params
from pipeline.report.statistics import Estimate, over_seeds

PAPER = Path(__file__).with_name("paper.csv")
SMALL = 0.05  # of the largest possible value: differences beyond this matter


def paper_numbers() -> pd.DataFrame:
    """The paper's own numbers: table (its label), environment, metric, method, mean, std, seeds, maximum."""
    return pd.read_csv(PAPER)


def read_rows(path: Path, stage: str) -> pd.DataFrame:
    """Rows that a stage wrote.

    Raises:
        UserError: they are missing.
    """
    if not path.is_file():
        raise UserError(f"{path} is missing: run `dvc repro {stage}`")
    return pd.read_csv(path)


def read_episodes(environment: str, method: str) -> pd.DataFrame:
    """The evaluation rows of one cell. Raises UserError as `read_rows` does."""
    return read_rows(paths.episodes(environment, method), f"evaluate@{environment}-{method}")


def source(dataset: play.PlayDataset) -> str:
    """Where play data came from, in words that can stand in a caption."""
    return {"scripted": "scripted demonstrations made here"}.get(dataset.meta["source"], dataset.meta["source"])


def compare(params: Params) -> pd.DataFrame:
    """One row for each environment, metric, method and goal set.

    The paper's numbers stand beside results over the first goal set, which is its protocol; other rows have none, nor
    have methods that the paper does not evaluate there. The standard error of the difference joins ours
    (pipeline.report.statistics) and the paper's std / sqrt(seeds); the paper's std also stands for the spread between
    seeds where we have one seed.
    """
    paper = paper_numbers().set_index(["environment", "metric", "method"])
    rows = []
    for environment in params.envs:
        data = source(play.load(paths.play(environment), envs.spec(environment)))
        goal_sets = params.environments[environment].evaluation.goals
        for metric in envs.report(environment).METRICS:
            for method in params.methods_in(environment):
                episodes = read_episodes(environment, method)
                key = (environment, metric.name, method)
                theirs = paper.loc[key] if key in paper.index else None
                for goals in goal_sets:
                    part = episodes[episodes["goals"] == goals]
                    ours = over_seeds(part, metric, deviation_of_one=0.0 if theirs is None else theirs["std"])
                    row = {
                        "environment": environment,
                        "metric": metric.name,
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
                    beside = theirs is not None and goals == goal_sets[0]
                    rows.append(row | (_beside(ours, theirs) if beside else {}))
    return pd.DataFrame(rows).reindex(columns=COLUMNS)


COLUMNS = ["environment", "metric", "method", "goals", "ours", "ours_std", "ours_standard_error", "seeds", "episodes"]
COLUMNS += ["profile", "data", "paper_table", "paper", "paper_std", "difference", "standard_error", "verdict"]


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
