"""Everything that tables and page show, gathered from the cells' results and data."""

from typing import Any

import pandas as pd

from beso import envs
from beso.data import play
from beso.data.play import PlayDataset
from beso.envs.protocol import Report
from pipeline import paths
from pipeline.params import Params
from pipeline.report import studies
from pipeline.report.comparison import compare, places, read_episodes, source
from pipeline.report.names import Names
from pipeline.report.sheets import sheets
from pipeline.report.tables import main_methods, main_rows, number, significant


def gather(params: Params) -> dict[str, Any]:
    """Values for templates and figures: parameters, names, comparison, main table, studies, data and their sources."""
    datasets = {environment: play.load(paths.play(environment), envs.spec(environment)) for environment in params.envs}
    sources = {name: source(dataset) for name, dataset in datasets.items()}
    comparison, names = compare(params, sources), Names(params)
    episodes = {
        environment: {names.methods[m]: read_episodes(environment, m) for m in params.methods_in(environment)}
        for environment in params.envs
    }
    return {
        "params": params,
        "names": names,
        "number": number,
        "significant": significant,
        "comparison": comparison,
        "methods": main_methods(params),
        "rows": main_rows(params, comparison, names),
        "places": list(places().itertuples()),
        "sheets": sheets(comparison, names),
        "studies": studies.tables(params),
        "students": studies.students(params),
        "datasets": datasets,
        "episodes": episodes,
        "own_tables": [t for name, data in datasets.items() for t in envs.report(name).tables(data, episodes[name])],
        "data": {name: beside_published(envs.report(name), dataset) for name, dataset in datasets.items()},
        "sources": sources,
    }


def beside_published(report: Report, dataset: PlayDataset) -> pd.DataFrame:
    """Columns `statistic`, `ours`, `published` (missing where not known)."""
    ours, published = report.statistics(dataset), report.PUBLISHED
    return pd.DataFrame([{"statistic": k, "ours": v, "published": published.get(k)} for k, v in ours.items()])
