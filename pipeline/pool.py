"""Independent jobs, one torch thread each: in processes on this machine or on a Ray cluster, as machine.yaml says.

Results come back in the order of the jobs and are the same bytes, whatever runs them: every job takes its randomness
from its own arguments.
"""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from typing import Any, TypeVar

import torch
from tqdm import tqdm

from beso.errors import UserError
from pipeline import cluster
from pipeline.guard import log_to_stderr
from pipeline.machine import Machine, available_workers

Result = TypeVar("Result")

HERE = Machine(workers=1)  # this process, with a single thread


def workers(machine: Machine) -> int:
    """How many jobs run at a time, at most. Raises UserError as `map_jobs` does."""
    return machine.workers or (cluster.cores(machine) if machine.engine == "ray" else available_workers())


def map_jobs(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], machine: Machine, description: str = ""
) -> Iterator[Result]:
    """Yield `function(*job)` for each job, in order.

    `function` must be importable. An exception in a job is raised here and ends the other workers, as does leaving the
    loop. One worker on this machine is this process, so that a debugger can follow.

    Raises:
        UserError: a worker was killed, BESO_WORKERS is no number of workers, or as `cluster.results` does.
    """
    jobs = list(jobs)
    if not jobs:
        return
    if machine.engine == "ray":
        results = cluster.results(function, jobs, machine, description)
    else:
        count = min(workers(machine), len(jobs))
        results = _in_processes(function, jobs, count) if count > 1 else _here(function, jobs)
    with closing(results), tqdm(total=len(jobs), desc=description, disable=None, file=sys.stderr) as progress:
        for result in results:
            yield result
            progress.update()


def _here(function: Callable[..., Result], jobs: list[tuple[Any, ...]]) -> Generator[Result, None, None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for job in jobs:
            yield function(*job)
    finally:
        torch.set_num_threads(threads)


def _in_processes(
    function: Callable[..., Result], jobs: list[tuple[Any, ...]], count: int
) -> Generator[Result, None, None]:
    # Spawned, not forked: PyBullet and torch keep threads and locks that a fork would copy half-way.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, mp_context=context, initializer=_start_worker) as executor:
        try:
            yield from executor.map(function, *zip(*jobs, strict=True))
        except BrokenProcessPool:
            raise UserError("a worker process was killed, perhaps for lack of memory; nothing was replaced") from None
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def _end_with_parent() -> None:
    """A worker whose parent was killed must not go on writing beside the next run's."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _start_worker() -> None:
    """One thread a worker: two threads on two busy cores run many times slower than one each."""
    torch.set_num_threads(1)
    log_to_stderr()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle; it ends the pool
