"""Everything that tables and page show, gathered from the grid's results and data."""

from typing import Any

from beso.data import play
from beso.data.spec import spec
from pipeline import names, paths
from pipeline.comparison import compare, source
from pipeline.data_statistics import beside_published
from pipeline.params import Params
from pipeline.tables import main_rows, number


def gather(params: Params) -> dict[str, Any]:
    """Values for the templates: parameters, names, the comparison and its main table, data statistics and sources."""
    datasets = {environment: play.load(paths.play(environment), spec(environment)) for environment in params.grid.envs}
    comparison = compare(params)
    return {
        "params": params,
        "names": names,
        "number": number,
        "comparison": comparison,
        "rows": main_rows(params, comparison),
        "data": {name: beside_published(dataset, spec(name)) for name, dataset in datasets.items()},
        "sources": {name: source(dataset) for name, dataset in datasets.items()},
    }
