"""What the machine offers: settings that are no parameters of results, in machine.yaml, which git ignores."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from beso.config import build, require, require_positive
from beso.errors import UserError
from pipeline.yaml import read_yaml

PATH = Path("machine.yaml")


def available_workers() -> int:
    """Number of processors this process may use: the environment variable BESO_WORKERS, or all it can run on.

    Raises:
        UserError: the variable is no positive number.
    """
    if share := os.environ.get("BESO_WORKERS"):  # of a stage that runs beside others (`beso run`)
        if not (share.isdecimal() and int(share) > 0):
            raise UserError(f"BESO_WORKERS = {share}: must be a number of workers, at least 1")
        return int(share)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Machine:
    """Each has a default, so that machine.yaml gives only what differs, or is not there.

    Results do not depend on these but for `device`: GPUs round and draw differently.

    Attributes:
        workers: worker processes; 0 means one a processor, or as many as the environment variable BESO_WORKERS says.
        device: auto, cpu, cuda or one GPU (cuda:1).
        save_seconds: how often the state of unfinished training is saved.
        engine: of workers: processes on this machine, or ray (a cluster of CPUs, needs device cpu).
        ray_address: the cluster that this machine belongs to, or host:port where it belongs to several.
        seeds_together: seeds of a cell that one process trains, in turns; for a GPU that one seed does not fill.
        cuda_graph: whether a GPU gets a step's passes as one recording.
    """

    workers: int = 0
    device: str = "auto"
    save_seconds: float = 60.0
    engine: Literal["processes", "ray"] = "processes"
    ray_address: str = "auto"
    seeds_together: int = 1
    cuda_graph: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "seeds_together")
        require(self.workers >= 0, f"workers = {self.workers}: must be 0 (one a processor) or more")
        require(self.save_seconds >= 0, f"save_seconds = {self.save_seconds}: must not be negative")
        # auto would be decided on each node, and the nodes' results might differ.
        require(self.engine != "ray" or self.device == "cpu", f"device = {self.device}: engine ray needs cpu")

    @classmethod
    def load(cls, path: Path = PATH) -> "Machine":
        """Read machine.yaml, if there is one. Raises UserError for a value that is not allowed."""
        return build(cls, read_yaml(path) or {}, str(path)) if path.is_file() else cls()
