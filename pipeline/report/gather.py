"""Everything that tables and page show, gathered from the cells' results and data; and what `tables` writes of it."""

import json
import math
from pathlib import Path
from typing import Any

import pandas as pd

from beso import envs
from beso.data import play
from beso.envs.reporting import Summary
from beso.files import read_json, replacing, write_json, write_text
from pipeline import paths
from pipeline.params import Params
from pipeline.report import figures, hyperparameters, readme, rows, studies, tables
from pipeline.report.comparison import compare, of_cells, places

SUMMARY = "summary.json"  # what archived runs have of play data
SOURCES = {"scripted": "scripted demonstrations made here"}  # of play data, in words that can stand in a caption


def write_tables(params: Params, root: Path, folder: Path) -> None:
    """Write LaTeX tables, comparison, metrics, figures, and README.md, which shows them, into a folder.

    Args:
        params, root: see `gather`.
    """
    values = gather(params, root)
    values["captions"] = figures.draw_all(params, values, folder / "figures")
    write_text(folder / "tables.tex", tables.render("tables.tex.j2", values))
    write_text(folder / "README.md", readme.render(values))
    write_text(folder / "comparison.csv", values["comparison"].to_csv(index=False, float_format="%.6g"))
    with replacing(folder / "metrics") as temporary:
        for name, scores in metrics(values["comparison"], values["episodes"]).items():
            write_json(temporary / f"{name}.json", scores)


def gather(params: Params, root: Path = Path()) -> dict[str, Any]:
    """Values for templates and figures: parameters, comparison, main table, studies, data and their sources.

    Args:
        params: their cells and studies are those that the run has.
        root: the run's folder: the repository, or an archive.

    Raises:
        UserError: something is missing.
    """
    summaries = {env: summary(root, env) for env in params.envs}
    sources = {env: SOURCES.get(str(of["source"]), str(of["source"])) for env, of in summaries.items()}
    episodes = {
        name: rows.read(root / cell.episodes, f"evaluate@{name}", cell.env, told.seeds, told.evaluation)
        for name, cell in params.cells.items()
        if (told := cell.evaluate)
    }
    of_studies = {
        name: rows.read(root / of.rows, f"study@{name}", of.env, of.seeds, of.evaluation, of.changes)
        for name, of in params.studies.items()
    }
    played = {
        env: {params.labels[cell.method]: episodes[cell.name] for cell in params.cells_in(env)} for env in params.envs
    }
    comparison, hyper = compare(params, episodes, of_studies, sources), hyperparameters.tables(params)
    return {
        "root": root,
        "params": params,
        "report": envs.report,
        "number": tables.number,
        "significant": tables.significant,
        "comparison": comparison,
        "methods": tables.main_methods(params),
        "seeds": {env: tables.seeds(params, env) for env in params.envs},
        "rows": tables.main_rows(params, comparison),
        "places": list(places().itertuples()),
        "sheets": tables.sheets(comparison),
        "studies": studies.tables(params, of_studies),
        "students": studies.students(params, episodes),
        "hyperparameters": hyper,
        "trains_less": any(table["share"] is not None and table["share"] < 1 for table in hyper),
        "play": summaries,
        "sources": sources,
        "episodes": episodes,
        "played": played,
        "own_tables": [table for env in params.envs for table in envs.report(env).tables(played[env])],
    }


def summary(root: Path, environment: str) -> Summary:
    """What the report shows of a run's play data, and their `source`: from the data, or as archived."""
    folder = root / paths.play(environment)
    if (folder / SUMMARY).is_file():
        return read_json(folder / SUMMARY)
    dataset = play.load(folder, envs.spec(environment))
    found = {"source": dataset.meta["source"], **envs.report(environment).summary(dataset)}
    return json.loads(json.dumps(found))  # as it would be read


def metrics(comparison: pd.DataFrame, episodes: dict[str, pd.DataFrame]) -> dict[str, dict[str, float]]:
    """What `dvc metrics show` and `dvc metrics diff` print, a line for each ENVIRONMENT/METHOD/GOALS.

    Every metric's mean and standard deviation over seeds, and mean length.
    """
    found: dict[str, dict[str, float]] = {}
    for row in of_cells(comparison).itertuples():
        of_cell = episodes[f"{row.environment}-{row.method}"]
        length = of_cell.loc[of_cell["goals"] == row.goals, "length"].mean()
        name = f"{row.environment}/{row.method}/{row.goals}"
        scores = found.setdefault(name, {"length": round(float(length), 1)})
        scores[row.metric] = round(row.ours, 4)
        if not math.isnan(row.ours_std):
            scores[f"{row.metric}_std"] = round(row.ours_std, 4)
    return found
