"""A pool of worker processes for independent jobs, one torch thread each.

Results come back in the order of the jobs, whatever the number of workers: every job takes its randomness from its own
arguments, so the number of workers never changes a number.
"""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import torch
from tqdm import tqdm

from beso.errors import UserError
from pipeline.stage import log_to_stderr

Result = TypeVar("Result")


def available_workers() -> int:
    """Number of processors this process may use: the environment variable BESO_WORKERS, or all it can run on."""
    if share := os.environ.get("BESO_WORKERS"):  # of a stage that runs beside others (`beso run`)
        return int(share)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_jobs(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], workers: int, description: str = ""
) -> Iterator[Result]:
    """Yield `function(*job)` for each job, in order, from `workers` processes (0: one a processor).

    `function` must be importable. An exception in a job is raised here and ends the other workers. One worker means
    this process, so that a debugger can follow.

    Raises:
        UserError: a worker process was killed.
    """
    jobs = list(jobs)
    workers = min(workers or available_workers(), len(jobs))
    progress = tqdm(total=len(jobs), desc=description, disable=None, file=sys.stderr)
    with progress:
        if workers <= 1:
            threads = torch.get_num_threads()
            torch.set_num_threads(1)
            try:
                for job in jobs:
                    yield function(*job)
                    progress.update()
            finally:
                torch.set_num_threads(threads)
            return
        # Spawned, not forked: PyBullet and torch keep threads and locks that a fork would copy half-way.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker) as executor:
            try:
                for result in executor.map(function, *zip(*jobs, strict=True)):
                    yield result
                    progress.update()
            except BrokenProcessPool:
                raise UserError(
                    "a worker process was killed, perhaps for lack of memory; nothing was replaced"
                ) from None
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
