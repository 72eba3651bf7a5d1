"""Independent jobs on a Ray cluster (see pipeline.pool).

All nodes need the working tree and the scratch folder at the same path. A job whose worker or node dies runs again;
training then continues from its saved state.
"""

import logging
import os
import pickle
import platform
import sys
from collections.abc import Callable, Generator
from typing import Any, TypeVar

import torch

from beso.errors import UserError
from pipeline.guard import log_to_stderr
from pipeline.machine import Machine

Result = TypeVar("Result")

RETRIES = 3  # of a job whose worker or node died; what kills every worker that it meets is the job's own fault
SETTINGS = {  # Ray's environment variables
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_IGNORE_UNHANDLED_ERRORS": "1",  # of jobs that fail beside the one whose error is raised
    "RAY_gcs_server_port_wait_time_s": "1",  # tries to connect, of as many seconds as the next says
    "RAY_py_gcs_connect_timeout_s": "5",
}


def cores(machine: Machine) -> int:
    """Number of processors of the cluster as it is now, at least one. Raises UserError as `results` does."""
    count = int(_connect(machine).cluster_resources().get("CPU", 0))
    if count < 1:
        raise UserError(f"machine.yaml: ray_address = {machine.ray_address}: the Ray cluster has no processors")
    return count


def results(
    function: Callable[..., Result], jobs: list[tuple[Any, ...]], machine: Machine, description: str
) -> Generator[Result, None, None]:
    """Yield `function(*job)` for each job, in order, from up to `machine.workers` workers (0: all of the cluster's).

    A worker is one processor.

    Raises:
        UserError: Ray is not installed, there is no cluster, it has no processors, a node lacks the working tree, or a
            job's workers died.
    """
    # Pickled here, so that a worker looks for the working tree before it imports anything of it.
    calls = [pickle.dumps((function, job)) for job in jobs]
    ray = _connect(machine)
    cores(machine)  # without any, jobs would wait for ever
    root, modules, most = os.getcwd(), list(sys.path), machine.workers or len(calls)

    def work(
        call: bytes,
    ) -> tuple[str | None, bytes]:  # nested, so that it travels by value: the worker may lack this file
        if not os.path.isdir(root):
            return platform.node(), b""
        os.chdir(root)
        sys.path[:] = dict.fromkeys([root, *modules, *sys.path])
        from pipeline.cluster import run_pickled

        return None, run_pickled(call)

    remote = ray.remote(num_cpus=1, max_retries=RETRIES)(work).options(name=description or "job")
    running: dict[Any, int] = {}
    finished: dict[int, Result] = {}
    try:
        started = 0
        for number in range(len(calls)):
            while number not in finished:
                while started < len(calls) and len(running) < most:
                    running[remote.remote(calls[started])] = started
                    started += 1
                (ready,), _ = ray.wait(list(running))
                finished[running.pop(ready)] = _result(ray, ready, root)
            yield finished.pop(number)
    finally:
        if running:  # disconnecting ends them; ray.cancel kills this process where a job just ends (Ray 2.60)
            ray.shutdown()


def run_pickled(call: bytes) -> bytes:
    """What a worker does: the pickled result of a pickled (function, arguments).

    Pickled, because Ray would hand out arrays that cannot be written to.
    """
    torch.set_num_threads(1)
    log_to_stderr()
    function, job = pickle.loads(call)
    return pickle.dumps(function(*job))


def _connect(machine: Machine) -> Any:
    """Ray's module, connected to the cluster until this process ends."""
    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
    try:
        import ray
    except ImportError:
        raise UserError("machine.yaml: engine = ray: Ray is not installed; pip install -e '.[ray]'") from None
    if not ray.is_initialized():
        try:
            # The workers' lines, and Ray's long ones on each death, stay in Ray's logs.
            ray.init(machine.ray_address, logging_level=logging.ERROR, log_to_driver=False)
        except (ConnectionError, RuntimeError, ray.exceptions.RayError) as error:
            reason = str(error).splitlines()[0].partition(". ")[0]
            raise UserError(
                f"machine.yaml: ray_address = {machine.ray_address}: no connection to a Ray cluster ({reason}); "
                "docs/ray.md tells how to start one"
            ) from None
    return ray


def _result(ray: Any, reference: Any, root: str) -> Any:
    try:
        node, result = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except ray.exceptions.RayError as error:
        raise UserError(
            f"Ray gave up a job ({type(error).__name__}); where its worker or node dies, it gets {RETRIES} more tries. "
            "Perhaps memory is lacking; nothing was replaced"
        ) from None
    if node is not None:
        raise UserError(f"{root} is missing on node {node}: all nodes need the working tree at the same path")
    return pickle.loads(result)
