"""Rows of evaluations and studies as files have them: read, and compared with what was to be played."""

from __future__ import annotations

import io
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from beso import envs
from beso.errors import UserError
from pipeline.report.statistics import PAIRS

if TYPE_CHECKING:
    from beso.evaluation.config import EvaluationConfig

# Lists of tasks: a column of single tasks and gaps would be read as decimal numbers.
TEXTS = {"tasks": str, "goal_tasks": str}


def parse(text: str, path: Path) -> pd.DataFrame:
    """Rows of a file's text. Raises UserError if it is no table of episodes."""
    try:
        rows = pd.read_csv(io.StringIO(text), dtype=TEXTS)
    except (pd.errors.EmptyDataError, pd.errors.ParserError) as error:
        raise UserError(f"{path} is empty or damaged ({' '.join(str(error).split())}): make it again") from None
    if missing := [name for name in PAIRS if name not in rows]:
        raise UserError(f"{path} has no column {missing[0]}: make it again")
    return rows


def once(rows: pd.DataFrame, keys: Sequence[str], path: Path) -> pd.DataFrame:
    """The rows themselves. Raises UserError if an episode is there twice."""
    twice = rows[rows.duplicated([*keys])]
    if len(twice):
        raise UserError(f"{path} has {_named(twice, keys)} twice: make it again")
    return rows


def _named(rows: pd.DataFrame, keys: Sequence[str]) -> str:
    return ", ".join(f"{key} {rows[key].iloc[0]}" for key in keys)


def read(
    path: Path,
    stage: str,
    env: str,
    seeds: Sequence[int],
    evaluation: EvaluationConfig,
    changes: Sequence[dict[str, Any]] = ({},),
) -> pd.DataFrame:
    """The rows that a stage wrote, one for each episode that it was to play.

    Args:
        stage: its name, for messages.
        seeds, evaluation: the episodes.
        changes: of the parameters of a study's samplings; each plays all of them.

    Raises:
        UserError: rows are missing, or twice there, or of something else, or a score is no number.
    """
    again = f"make it again: `dvc repro --force --single-item {stage}`"
    if not path.is_file():
        raise UserError(f"{path} is missing: run `dvc repro {stage}`")
    try:
        rows = parse(path.read_text(encoding="utf-8"), path)
    except UnicodeDecodeError:
        raise UserError(f"{path} is not UTF-8 text: {again}") from None
    numbers = ["length", *(metric.name for metric in envs.report(env).METRICS)]
    keys = [*changes[0], *PAIRS]
    if missing := [name for name in [*keys, *numbers] if name not in rows]:
        raise UserError(f"{path} has no column {missing[0]}: {again}")
    episodes = itertools.product(changes, seeds, evaluation.goals, range(evaluation.rollouts))
    planned = pd.DataFrame(
        [{**change, **dict(zip(PAIRS, episode, strict=True))} for change, *episode in episodes], columns=keys
    )
    planned = parse(planned.to_csv(index=False), path)  # as they would be read
    for name in numbers:
        scores = pd.to_numeric(rows[name], errors="coerce").to_numpy(dtype=float)
        if not np.isfinite(scores).all():
            wrong = int(np.argmin(np.isfinite(scores)))
            raise UserError(f"{path}: {name} of row {wrong + 1} is {str(rows[name].iloc[wrong])!r}, no number: {again}")
    once(rows, keys, path)
    both = planned.astype(object).merge(rows[keys].astype(object), how="outer", indicator="where", sort=False)
    for side, problem in (("left_only", "lacks"), ("right_only", "has, unasked for,")):
        which = both[both["where"] == side]
        if len(which):
            raise UserError(f"{path} {problem} {len(which)} episodes, the first of {_named(which, keys)}: {again}")
    return rows
