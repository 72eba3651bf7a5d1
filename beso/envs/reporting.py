"""What an environment's room tells the report, as types."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from beso.data.play import PlayDataset
    from beso.envs.protocol import Drawing, Episodes, Metric, Table

Summary = dict[str, Any]  # JSON values; "statistics" has a number for each statistic's name


class Report(Protocol):
    """What only the report must know of an environment: the module `beso.envs.<name>.report`."""

    LABEL: str  # the paper's name
    GOAL_LABELS: dict[str, str]  # by goal set
    METRICS: tuple[Metric, ...]
    PUBLISHED: dict[str, float]  # statistics of the published play data, as far as known

    def summary(self, dataset: PlayDataset) -> Summary:
        """All that the report shows of play data, small enough for an archive that lacks the data themselves."""

    def drawings(self, play: Summary, episodes: Episodes) -> list[Drawing]:
        """Figures that only this environment has."""

    def tables(self, episodes: Episodes) -> list[Table]:
        """Tables that only this environment has."""
