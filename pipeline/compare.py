"""`beso compare A B`: whether run B's results differ from run A's by more than chance.

A run is a folder that holds one (`.`, or an archive like reports/published/cpu), a git revision, or a folder in a
revision (`REVISION:FOLDER`). A revision's episodes come from DVC's cache or remote through its dvc.lock; where neither
has them, its reports/comparison.csv stands for them.

Episodes are paired by seed, goal set and number, so that what both runs share (starts, goals, models trained alike)
does not blur the difference. `dvc metrics diff` shows means alone.
"""

import io
import math
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from beso import envs
from beso.envs.protocol import Metric
from beso.errors import UserError
from pipeline import paths
from pipeline.params import PATH
from pipeline.profile import leaves
from pipeline.report.comparison import of_cells, verdict
from pipeline.report.names import value
from pipeline.report.statistics import PAIRS, Estimate, difference, of_difference, over_seeds
from pipeline.report.tables import number
from pipeline.yaml import parse_yaml

COMPARISON = "comparison.csv"
SHOWN = 10  # parameters that differ, at most
HEADS = ("Environment", "Method", "Goals", "Metric", "A", "B", "B - A", "95 %", "B is", "Episodes")


class Files(NamedTuple):
    """A run's files: their names by a pattern, and the text of one, None where it cannot be had."""

    find: Callable[[str], list[Path]]
    read: Callable[[Path], str | None]


class Source(NamedTuple):
    """One cell or one sampling of a study: environment, method, what a study changes."""

    environment: str
    method: str
    changes: str


class Run(NamedTuple):
    """One run.

    Attributes:
        params: params.yaml, as it stands there.
        episodes: evaluation rows, as far as they are to be had.
        summary: means and intervals of its comparison.csv, by environment, metric, method and goal set.
    """

    params: dict[str, Any]
    episodes: dict[Source, pd.DataFrame]
    summary: dict[tuple[str, str, str, str], Estimate]


class Line(NamedTuple):
    """One difference of two runs.

    Attributes:
        first, second: the means, of the paired episodes if there are pairs.
        change: B less A.
        pairs: their number; 0 if episodes could not be paired.
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
    files = _folder(Path(name)) if Path(name).is_dir() else _revision(name)
    text = files.read(PATH)
    if text is None:
        raise UserError(f"{name}: no {PATH} there, so no run")
    params = parse_yaml(text, f"{name}: {PATH}") or {}
    if "methods" not in params:
        raise UserError(f"{name}: {PATH} there names no methods, so it is no run's")
    episodes = {**_cells(files, params), **_studies(files, params)}
    summary = _csv(files, paths.REPORTS / COMPARISON)
    summary = _csv(files, Path(COMPARISON)) if summary is None else summary
    if not episodes and not _estimates(summary):
        raise UserError(f"{name}: no results there: run `dvc repro`, or `dvc pull` for those of a revision")
    return Run(params, episodes, _estimates(summary))


def _cells(files: Files, params: dict[str, Any]) -> dict[Source, pd.DataFrame]:
    """Rows of evaluation, in the order of the parameters' methods; what they no longer name is left over."""
    methods = list(params["methods"])
    found = [
        path for path in files.find("results/*/*.csv") if path.parent.name in envs.names() and path.stem in methods
    ]
    sources = {Source(path.parent.name, path.stem, ""): path for path in found}
    if "cells" in params:  # archives of older versions have a grid instead
        sources = {s: path for s, path in sources.items() if f"{s.environment}-{s.method}" in params["cells"]}
    ordered = sorted(sources, key=lambda source: (source.environment, methods.index(source.method)))
    return {s: rows for s in ordered if (rows := _csv(files, sources[s])) is not None}


def _studies(files: Files, params: dict[str, Any]) -> dict[Source, pd.DataFrame]:
    """Rows of studies, sampling by sampling."""
    found = {}
    for name, study in (params.get("studies") or {}).items():
        rows, varied = _csv(files, Path("results/studies") / f"{name}.csv"), list(study["vary"])
        if rows is not None and {*varied} <= {*rows.columns}:
            for values, part in rows.groupby(varied, sort=False, dropna=False):
                changes = ", ".join(value(None if pd.isna(v) else v) for v in values)
                found[Source(study["env"], study["method"], f"{name}: {changes}")] = part
    return found


def _folder(folder: Path) -> Files:
    def read(path: Path) -> str | None:
        file = folder / path
        return file.read_text(encoding="utf-8") if file.is_file() else None

    return Files(lambda pattern: [path.relative_to(folder) for path in folder.glob(pattern)], read)


def _revision(name: str) -> Files:
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

    return Files(lambda pattern: [Path(path).relative_to(root) for path in files.glob(str(root / pattern))], read)


def _csv(files: Files, path: Path) -> pd.DataFrame | None:
    text = files.read(path)
    try:
        return None if text is None else pd.read_csv(io.StringIO(text))
    except pd.errors.EmptyDataError:
        raise UserError(f"{path} is empty: remove it or make it again") from None


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
    yield from _summaries(first, second)


def _line(source: Source, goals: str, metric: Metric, rows: pd.DataFrame, others: pd.DataFrame) -> Line:
    change = difference(others, rows, metric)
    if change is None:
        a, b = over_seeds(rows, metric), over_seeds(others, metric)
        return Line(source, goals, metric, a.mean, b.mean, _apart(a, b), 0)
    pairs = rows.merge(others, on=PAIRS)
    first, second = (float(pairs.groupby("seed")[f"{metric.name}_{side}"].mean().mean()) for side in "xy")
    return Line(source, goals, metric, first, second, change, len(pairs))


def _apart(first: Estimate, second: Estimate) -> Estimate:
    return Estimate(second.mean - first.mean, math.nan, *of_difference(second, first))


def _summaries(first: Run, second: Run) -> Iterator[Line]:
    """Differences of cells of which one run has no episodes, from the means and intervals of both."""
    for key, a in first.summary.items():
        environment, name, method, goals = key
        source = Source(environment, method, "")
        metric = next((m for m in envs.report(environment).METRICS if m.name == name), None)
        if metric and key in second.summary and not (source in first.episodes and source in second.episodes):
            b = second.summary[key]
            yield Line(source, goals, metric, a.mean, b.mean, _apart(a, b), 0)


def _estimates(comparison: pd.DataFrame | None) -> dict[tuple[str, str, str, str], Estimate]:
    if comparison is None or "ours_low" not in comparison:  # of a version that had no intervals
        return {}
    return {
        (row.environment, row.metric, row.method, row.goals): Estimate(
            row.ours, row.ours_std, row.ours_low, row.ours_high
        )
        for row in of_cells(comparison).itertuples()
    }


def same(first: Run, second: Run) -> bool:
    """Whether two runs have the same rows, or the same summaries where neither has rows."""
    if first.episodes or second.episodes:
        return first.episodes.keys() == second.episodes.keys() and all(
            rows.reset_index(drop=True).equals(second.episodes[source].reset_index(drop=True))
            for source, rows in first.episodes.items()
        )
    a, b = ({key: (e.mean, e.low, e.high) for key, e in run.summary.items()} for run in (first, second))
    return a == b


def report(names: tuple[str, str], runs: tuple[Run, Run], markdown: bool) -> str:
    """What the command prints."""
    parameters = _parameters(*runs, markdown)
    if same(*runs):
        count = sum(map(len, runs[0].episodes.values()))
        what = f"the same in all {count:,} episodes" if count else f"the same means and intervals in {COMPARISON}"
        return "\n".join([f"{names[0]} and {names[1]} do not differ: {what}.", *parameters])
    lines = list(compare(*runs))
    if not lines:
        raise UserError(f"{names[0]} and {names[1]} have no cell in common of which both have results")
    texts = [_texts(line, runs[0].params) for line in lines]
    told = sum(text[8] in ("better", "worse") for text in texts)
    notes = [
        f"{told} of {len(lines)} differences are beyond chance; of {len(lines)} that are none, about"
        f" {0.05 * len(lines):.0f} would seem so.",
        "Same: the whole interval is within 5 % of the largest value. Episodes: pairs by seed, goals and number;"
        " none: the runs' means were compared.",
    ]
    if any(math.isnan(line.change.deviation) and line.pairs for line in lines):
        notes.append("Of one seed, an interval speaks of the one trained model of each run.")
    for name, run, other in zip(names, runs, reversed(runs), strict=True):
        alone = sorted(
            {f"{s.environment} {s.method} {s.changes}".strip() for s in run.episodes.keys() - other.episodes}
        )
        notes += [f"Only {name} has episodes of: {'; '.join(alone)}."] if alone else []
    heading = [f"A: {names[0]}, B: {names[1]}", "", *(_markdown if markdown else _aligned)(texts), ""]
    return "\n".join([*heading, *([f"{note}\n" for note in notes] if markdown else notes), *parameters])


def _texts(line: Line, params: dict[str, Any]) -> tuple[str, ...]:
    room, source = envs.report(line.source.environment), line.source
    method = params["methods"].get(source.method, {}).get("label", source.method) + (
        f" ({source.changes})" if source.changes else ""
    )
    change = line.change
    return (
        room.LABEL,
        method,
        room.GOAL_LABELS[line.goals],
        line.metric.label,
        number(line.first),
        number(line.second),
        f"{round(change.mean, 3) + 0.0:+.3f}",
        f"{number(change.low)} to {number(change.high)}",
        verdict(change.low, change.high, line.metric.maximum),
        f"{line.pairs:,}" if line.pairs else "none",
    )


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    table = [HEADS, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in table]


def _markdown(rows: list[tuple[str, ...]]) -> list[str]:
    return ["| " + " | ".join(row) + " |" for row in (HEADS, ("---",) * len(HEADS), *rows)]


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
