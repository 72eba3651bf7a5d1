"""The appendix's hyper-parameter tables, made from parameters: this run's values beside the paper profile's."""

import dataclasses
from typing import Any

from pipeline import names
from pipeline import params as parameters
from pipeline.params import Params
from pipeline.profile import COMPLETE, FOLDER


def tables(params: Params) -> list[dict[str, Any]]:
    """One table for each environment and method of the grid: its title, and rows of name, ours and the paper's."""
    paper = parameters.load(FOLDER / f"{COMPLETE}.yaml")
    found = []
    for environment in params.grid.envs:
        for method in params.grid.methods:
            ours, theirs = (_values(p, environment, method) for p in (params, paper))
            title = f"{names.METHODS[method]}, {names.ENVIRONMENTS[environment]}"
            found.append({"title": title, "rows": [(name, ours[name], theirs[name]) for name in ours]})
    return found


def _values(params: Params, environment: str, method: str) -> dict[str, str]:
    training = dataclasses.asdict(params.methods[method].train[environment])
    sampling = dataclasses.asdict(params.sampling(environment, method))
    return {**_flat(training["model"]), **_flat(training["optimization"]), **_flat(sampling, "sampling: ")}


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested mappings as one, named by their innermost keys in words."""
    flat: dict[str, str] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, prefix)
        else:
            flat[prefix + name.replace("_", " ")] = _text(value)
    return flat


def _text(value: Any) -> str:
    if value is None:
        return "all"
    return f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")
