"""`beso compare A B`: whether run B's results differ from run A's by more than chance.

A run is a folder that holds one (`.`, or an archive like reports/published/cpu), a git revision, or a folder in a
revision (`REVISION:FOLDER`). A revision's episodes come from DVC's cache or remote through its dvc.lock.

Episodes are paired by seed, goal set and number, so that what both runs share (starts, goals, models trained alike)
does not blur the difference. `dvc metrics diff` shows means alone.
"""

import math
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from beso import envs
from beso.envs.protocol import Metric
from beso.errors import UserError
from pipeline.params import PATH
from pipeline.profile import leaves
from pipeline.recipes import CellPaths
from pipeline.report.comparison import verdict
from pipeline.report.names import value
from pipeline.report.rows import once, parse
from pipeline.report.statistics import PAIRS, Estimate, difference, of_difference, over_seeds
from pipeline.report.tables import number
from pipeline.yaml import parse_yaml

SHOWN = 10  # parameters that differ, at most
HEADS = ("Environment", "Method", "Goals", "Metric", "A", "B", "B - A", "95 %", "B is", "Episodes")

Read = Callable[[Path], str | None]  # the text of one of a run's files, None where it cannot be had


class Source(NamedTuple):
    """One cell or one sampling of a study: environment, method, what a study changes."""

    environment: str
    method: str
    changes: str


class Run(NamedTuple):
    """One run: params.yaml, as it stands there, and the evaluation rows that are to be had."""

    params: dict[str, Any]
    episodes: dict[Source, pd.DataFrame]


class Line(NamedTuple):
    """One difference of two runs.

    Attributes:
        first, second: the means, of the paired episodes if there are pairs.
        change: B less A.
        pairs: their number; 0 if no episodes fit.
    """

    source: Source
    goals: str
    metric: Metric
    first: float
    second: float
    change: Estimate
    pairs: int


def load(name: str) -> Run:
    """Find a run.

    Raises:
        UserError: there is none of that name, or it has no results.
    """
    read = _folder(Path(name)) if Path(name).is_dir() else _revision(name)
    text = read(PATH)
    if text is None:
        raise UserError(f"{name}: no {PATH} there, so no run")
    params = parse_yaml(text, f"{name}: {PATH}") or {}
    if not {"methods", "cells"} <= {*params}:
        raise UserError(f"{name}: {PATH} there names no methods or no cells, so it is no run's")
    episodes = dict(_episodes(read, params))
    if not episodes:
        raise UserError(f"{name}: no results there: run `dvc repro`, or `dvc pull` for those of a revision")
    return Run(params, episodes)


def _episodes(read: Read, params: dict[str, Any]) -> Iterator[tuple[Source, pd.DataFrame]]:
    """Rows of evaluations, then of studies, sampling by sampling, in the order of the parameters."""
    for cell in params["cells"].values():
        path = CellPaths(cell["env"], cell["method"]).episodes
        text = read(path)
        if text is not None and cell["env"] in envs.names():
            yield Source(cell["env"], cell["method"], ""), once(parse(text, path), PAIRS, path)
    for name, study in (params.get("studies") or {}).items():
        varied = list(study["vary"])
        path = Path("results/studies") / f"{name}.csv"
        text = read(path)
        if text is not None and {*varied} <= {*(rows := parse(text, path)).columns}:
            for values, part in once(rows, [*varied, *PAIRS], path).groupby(varied, sort=False, dropna=False):
                changes = ", ".join(value(None if pd.isna(v) else v) for v in values)
                yield Source(study["env"], study["method"], f"{name}: {changes}"), part


def _folder(folder: Path) -> Read:
    def read(path: Path) -> str | None:
        file = folder / path
        return file.read_text(encoding="utf-8") if file.is_file() else None

    return read


def _revision(name: str) -> Read:
    """A revision's files, those that DVC keeps among them. Raises UserError if there is no such revision."""
    revision, _, folder = name.partition(":")
    command = ["git", "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}"]
    if subprocess.run(command, capture_output=True).returncode != 0:
        raise UserError(f"{name}: neither a folder nor a git revision")
    from dvc.api import DVCFileSystem  # takes a second to import

    files, root = DVCFileSystem(".", rev=revision), Path("/") / folder

    def read(path: Path) -> str | None:
        try:
            return files.read_text(str(root / path), encoding="utf-8")
        except FileNotFoundError:  # not in this revision, or neither in the cache nor in a remote
            return None

    return read


def compare(first: Run, second: Run) -> Iterator[Line]:
    """Every difference of what both have, in the order of the first run's parameters."""
    for source, rows in first.episodes.items():
        if source in second.episodes:
            others = second.episodes[source]
            for metric in envs.report(source.environment).METRICS:
                for goals in rows["goals"].unique():
                    parts = [part[part["goals"] == goals] for part in (rows, others)]
                    if all(len(part) and metric.name in part for part in parts):
                        yield _line(source, goals, metric, *parts)


def _line(source: Source, goals: str, metric: Metric, rows: pd.DataFrame, others: pd.DataFrame) -> Line:
    change = difference(others, rows, metric)
    if change is None:
        a, b = over_seeds(rows, metric), over_seeds(others, metric)
        change = Estimate(b.mean - a.mean, math.nan, *of_difference(b, a))
        return Line(source, goals, metric, a.mean, b.mean, change, 0)
    pairs = rows.merge(others, on=PAIRS)
    first, second = (float(pairs.groupby("seed")[f"{metric.name}_{side}"].mean().mean()) for side in "xy")
    return Line(source, goals, metric, first, second, change, len(pairs))


def same(first: Run, second: Run) -> bool:
    """Whether two runs have the same rows."""
    return first.episodes.keys() == second.episodes.keys() and all(
        rows.reset_index(drop=True).equals(second.episodes[source].reset_index(drop=True))
        for source, rows in first.episodes.items()
    )


def report(names: tuple[str, str], runs: tuple[Run, Run], markdown: bool) -> str:
    """What the command prints."""
    parameters = _parameters(*runs, markdown)
    if same(*runs):
        count = sum(map(len, runs[0].episodes.values()))
        return "\n".join([f"{names[0]} and {names[1]} do not differ: the same in all {count:,} episodes.", *parameters])
    lines = list(compare(*runs))
    if not lines:
        raise UserError(f"{names[0]} and {names[1]} have no results of the same cell")
    table = [HEADS, *(_texts(line, runs[0].params) for line in lines)]
    told = sum(text[8] in ("better", "worse") for text in table)
    notes = [
        f"{told} of {len(lines)} differences are beyond chance; of {len(lines)} that are none, about"
        f" {0.05 * len(lines):.0f} would seem so.",
        "Same: the whole interval is within 5 % of the largest value. Episodes: pairs by seed, goals and number;"
        " none: the runs' means were compared.",
    ]
    if any(math.isnan(line.change.deviation) and line.pairs for line in lines):
        notes.append("Of one seed, an interval speaks of the one trained model of each run.")
    for name, run, other in zip(names, runs, reversed(runs), strict=True):
        alone = sorted(" ".join(source).strip() for source in run.episodes.keys() - other.episodes)
        notes += [f"Only {name} has episodes of: {'; '.join(alone)}."] if alone else []
    if markdown:
        texts = ["| " + " | ".join(row) + " |" for row in (HEADS, ("---",) * len(HEADS), *table[1:])]
        notes = [f"{note}\n" for note in notes]
    else:
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        texts = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in table]
    return "\n".join([f"A: {names[0]}, B: {names[1]}", "", *texts, "", *notes, *parameters])


def _texts(line: Line, params: dict[str, Any]) -> tuple[str, ...]:
    (environment, name, changes), change = line.source, line.change
    room, label = envs.report(environment), params["methods"].get(name, {}).get("label", name)
    return (
        room.LABEL,
        f"{label} ({changes})" if changes else label,
        room.GOAL_LABELS[line.goals],
        line.metric.label,
        number(line.first),
        number(line.second),
        f"{round(change.mean, 3) + 0.0:+.3f}",
        f"{number(change.low)} to {number(change.high)}",
        verdict(change.low, change.high, line.metric.maximum),
        f"{line.pairs:,}" if line.pairs else "none",
    )


def _parameters(first: Run, second: Run, markdown: bool) -> list[str]:
    """The parameters that differ, a line each."""
    a, b = (dict(leaves(run.params)) for run in (first, second))
    missing = "(none)"
    differ = [key for key in {**a, **b} if a.get(key, missing) != b.get(key, missing)]
    lines = [f"{key}: {a.get(key, missing)} -> {b.get(key, missing)}" for key in differ[:SHOWN]]
    if len(differ) > SHOWN:
        lines.append(f"and {len(differ) - SHOWN} more")
    heading = f"Parameters that differ: {len(differ)}" if differ else "No parameter differs."
    return [heading, *(f"- {line}" if markdown else f"  {line}" for line in lines)]
