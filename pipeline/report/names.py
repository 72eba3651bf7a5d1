"""The paper's names for what params.yaml names in lower case, from params.yaml and from the environments' rooms."""

from typing import Any

from beso import envs
from pipeline.params import Params
from pipeline.recipes import CellPaths

# Samplers and schedules as the paper's tables have them.
VALUES = {
    "ddim": "DDIM",
    "dpm_2": "DPM",
    "dpm_2_ancestral": "DPM, ancestral",
    "dpmpp_2m": "DPM++(2M)",
    "dpmpp_2s": "DPM++(2S)",
    "dpmpp_2s_ancestral": "DPM++(2S), ancestral",
    "euler_ancestral": "Euler, ancestral",
    "iddpm": "IDDPM",
    "ve": "VE",
    "ve_published": "VE, as published",
    "vp": "VP",
    "vp_published": "VP, as published",
}


class Names:
    """Names of environments, methods, metrics and goal sets.

    Attributes:
        environments, methods: labels by name.
    """

    def __init__(self, params: Params) -> None:
        self._reports = {name: envs.report(name) for name in params.envs}
        self.environments = {name: report.LABEL for name, report in self._reports.items()}
        self.methods = params.labels

    def environment(self, environment: str) -> str:
        """An environment's label, or its name in words where this run does not have it."""
        return self.environments.get(environment, words(environment))

    def method(self, method: str) -> str:
        """A method's label, or its name in words where this run does not have it."""
        return self.methods.get(method, words(method))

    def metric(self, environment: str, metric: str) -> str:
        """A metric's label, or its name in words where this run does not have the environment."""
        found = self._reports[environment].METRICS if environment in self._reports else ()
        return next((m.label for m in found if m.name == metric), words(metric))

    def goals(self, environment: str, goals: str) -> str:
        """A goal set's label."""
        return self._reports[environment].GOAL_LABELS[goals]

    def study(self, name: str, cell: CellPaths) -> str:
        """What a study is of, from its name, less the environment's, and its cell."""
        what = words(name.removesuffix(f"_{cell.env}"))
        return f"{what}: {self.method(cell.method)} in {self.environment(cell.env)}"


def words(name: str) -> str:
    """A parameter's name as it stands in a table's head: `guidance_scale` is Guidance scale."""
    return name[:1].upper() + name[1:].replace("_", " ")


def value(of: Any) -> str:
    """A parameter's value as it stands in a table."""
    if of is None:
        return "all"
    if isinstance(of, str):
        return VALUES.get(of, words(of))
    return f"{of:g}" if isinstance(of, float) else str(of)
