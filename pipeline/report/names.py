"""The paper's names for what params.yaml names in lower case, from params.yaml and from the environments' rooms."""

from beso import envs
from pipeline.params import Params


class Names:
    """Names of environments, methods, metrics and goal sets.

    Attributes:
        environments, methods: labels by name.
    """

    def __init__(self, params: Params) -> None:
        self._reports = {name: envs.report(name) for name in params.envs}
        self.environments = {name: report.LABEL for name, report in self._reports.items()}
        self.methods = {name: block.label for name, block in params.methods.items()}

    def metric(self, environment: str, metric: str) -> str:
        """A metric's label."""
        return next(m.label for m in self._reports[environment].METRICS if m.name == metric)

    def goals(self, environment: str, goals: str) -> str:
        """A goal set's label."""
        return self._reports[environment].GOAL_LABELS[goals]
