"""Everything that tables and page show, gathered from the cells' results and data."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from beso import envs
from beso.data import play
from beso.envs.reporting import Report, Summary
from beso.files import read_json
from pipeline import paths
from pipeline.params import Params
from pipeline.report import hyperparameters, studies
from pipeline.report.comparison import compare, places, read_episodes, source
from pipeline.report.names import Names
from pipeline.report.sheets import sheets
from pipeline.report.tables import main_methods, main_rows, number, significant

SUMMARY = "summary.json"  # what archived runs have of play data


def gather(params: Params, root: Path = Path()) -> dict[str, Any]:
    """Values for templates and figures: parameters, names, comparison, main table, studies, data and their sources.

    Args:
        params: their cells and studies are those that the run has.
        root: the run's folder: the repository, or an archive.
    """
    summaries = {environment: summary(root, environment) for environment in params.envs}
    sources = {name: source(of["source"]) for name, of in summaries.items()}
    comparison, names = compare(params, sources, root), Names(params)
    episodes = {
        env: {names.methods[cell.method]: read_episodes(root, cell) for cell in params.cells_in(env)}
        for env in params.envs
    }
    return {
        "root": root,
        "params": params,
        "names": names,
        "number": number,
        "significant": significant,
        "comparison": comparison,
        "methods": main_methods(params),
        "rows": main_rows(params, comparison, names),
        "places": list(places().itertuples()),
        "sheets": sheets(comparison, names),
        "studies": studies.tables(params, root),
        "students": studies.students(params, root),
        "play": summaries,
        "episodes": episodes,
        "own_tables": [table for name in params.envs for table in envs.report(name).tables(episodes[name])],
        "data": {name: beside_published(envs.report(name), of["statistics"]) for name, of in summaries.items()},
        "sources": sources,
        "trains_less": hyperparameters.trains_less(params),
    }


def summary(root: Path, environment: str) -> Summary:
    """What the report shows of a run's play data, and their `source`: from the data, or as archived."""
    folder = root / paths.play(environment)
    if (folder / SUMMARY).is_file():
        return read_json(folder / SUMMARY)
    dataset = play.load(folder, envs.spec(environment))
    found = {"source": dataset.meta["source"], **envs.report(environment).summary(dataset)}
    return json.loads(json.dumps(found))  # as it would be read


def beside_published(report: Report, ours: dict[str, float]) -> pd.DataFrame:
    """Columns `statistic`, `ours`, `published` (missing where not known)."""
    published = report.PUBLISHED
    return pd.DataFrame([{"statistic": k, "ours": v, "published": published.get(k)} for k, v in ours.items()])
