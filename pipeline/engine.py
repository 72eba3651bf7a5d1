"""Where independent jobs run: in processes on this machine or on a Ray cluster, as machine.yaml says.

Results are the same bytes, whatever the engine: every job takes its randomness from its own arguments.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from pipeline import cluster, pool
from pipeline.machine import Machine

Result = TypeVar("Result")


def map_jobs(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], machine: Machine, description: str = ""
) -> Iterator[Result]:
    """Yield `function(*job)` for each job, in order. Raises UserError as the engines do."""
    if machine.engine == "ray":
        return cluster.map_jobs(function, jobs, machine, description)
    return pool.map_jobs(function, jobs, machine.workers, description)


def workers(machine: Machine) -> int:
    """How many jobs run at a time, at most."""
    return machine.workers or (cluster.cores(machine) if machine.engine == "ray" else pool.available_workers())
