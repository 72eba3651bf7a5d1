"""Ray as the engine behind the worker pool, on a cluster of two nodes with one processor each."""

import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import psutil
import pytest
import torch

from beso.errors import UserError
from beso.files import write_text
from pipeline import pool, profile
from pipeline.machine import Machine
from stages import resolve
from stages.collect import collect
from stages.evaluate import evaluate_cell
from stages.train import train_cell
from stages.trials import make_trials

from .conftest import Workspace

NODE = {"num_cpus": 1, "object_store_memory": 80 << 20}
ENVIRONMENT, METHOD = "block_push", "c_beso"


@pytest.fixture(scope="module")
def smoke():
    return profile.load("smoke")


def describe(folder, x):
    """Waits for the second job, so that both nodes have a worker."""
    (folder / str(x)).touch()
    wait(lambda: len(list(folder.iterdir())) > 1)
    return torch.get_num_threads(), np.full(100_000, x), os.getpid()


def wait(until, seconds=240):
    deadline = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_no_cluster_is_one_line(smoke):
    """First of all: later there is one."""
    machine = Machine(device="cpu", engine="ray")
    with pytest.raises(UserError, match=r"^machine.yaml: ray_address = auto: no connection to a Ray cluster .*$"):
        list(pool.map_jobs(describe, [(None, 0)], machine))


def test_a_cluster_whose_token_is_not_here_is_one_line(tmp_path):
    code = """
from pipeline import cluster
from pipeline.machine import Machine
try:
    cluster.cores(Machine(device="cpu", engine="ray", ray_address="127.0.0.1:1"))
except cluster.UserError as error:
    print(error)
"""
    settings = {"HOME": str(tmp_path), "RAY_AUTH_MODE": "token"}
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | settings, capture_output=True, text=True)
    (line,) = done.stdout.splitlines()
    assert line.startswith("machine.yaml: ray_address = 127.0.0.1:1: no connection to a Ray cluster (Token authen")
    assert line.endswith("; docs/ray.md tells how to start one")


def test_a_cluster_without_processors_is_one_line():
    """Jobs would wait for ever."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    import ray

    ray.init(**{**NODE, "num_cpus": 0}, include_dashboard=False)
    try:
        for ask in (pool.workers, lambda machine: list(pool.map_jobs(describe, [(None, 0)], machine))):
            with pytest.raises(UserError, match=r"^machine\.yaml: ray_address = auto: the Ray cluster has no"):
                ask(Machine(device="cpu", engine="ray"))
    finally:
        ray.shutdown()


def test_missing_ray_is_one_line(smoke, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    machine = Machine(device="cpu", engine="ray")
    with pytest.raises(UserError, match=r"^machine.yaml: engine = ray: Ray is not installed; pip install .*$"):
        list(pool.map_jobs(describe, [(None, 0)], machine))


def test_ray_needs_the_device_to_be_named(smoke):
    with pytest.raises(ValueError, match="device = auto: engine ray needs cpu"):
        Machine(engine="ray")


@pytest.fixture(scope="module")
def cluster():
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    import ray
    from ray.cluster_utils import Cluster

    started = Cluster(initialize_head=True, head_node_args={**NODE, "include_dashboard": False})
    started.add_node(**NODE)
    yield started
    running = descendants()
    ray.shutdown()
    started.shutdown()
    assert psutil.wait_procs(running, timeout=30)[1] == []


def descendants():
    """All processes below this one but those of the standard library's pools."""
    found = psutil.Process().children(recursive=True)
    return [process for process in found if "multiprocessing" not in " ".join(process.cmdline())]


@pytest.fixture
def machine(cluster):
    return Machine(device="cpu", save_seconds=0, engine="ray", ray_address=cluster.address)


def kill_second_node(cluster):
    (node,) = cluster.worker_nodes
    cluster.remove_node(node, allow_graceful=False)


def test_results_come_in_the_order_of_the_jobs_from_one_thread_each(machine, tmp_path):
    results = list(pool.map_jobs(describe, [(tmp_path, i) for i in range(6)], machine))
    assert [array[0] for _, array, _ in results] == list(range(6))
    assert {threads for threads, _, _ in results} == {1}
    pids = {pid for _, _, pid in results}
    assert len(pids) == pool.workers(machine) == 2
    assert os.getpid() not in pids
    assert all(array.flags.writeable for _, array, _ in results), "as from the process pool"
    assert list(pool.map_jobs(describe, [], machine)) == []


def fail(folder, x):
    (folder / f"{x}-{time.monotonic()}").touch()
    if x == 1:
        raise UserError("job 1 is wrong")


def test_a_users_mistake_reaches_the_caller_and_is_not_tried_again(machine, tmp_path):
    with pytest.raises(UserError, match=r"^job 1 is wrong$"):
        list(pool.map_jobs(fail, [(tmp_path, 0), (tmp_path, 1)], machine))
    time.sleep(0.5)
    assert len(list(tmp_path.glob("1-*"))) == 1


def kill_worker(x):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_job_that_kills_its_workers_is_an_error_and_no_endless_wait(machine):
    with pytest.raises(UserError, match="Ray gave up a job"):
        list(pool.map_jobs(kill_worker, [(0,)], machine))


def move_away():
    os.rename(os.getcwd(), os.getcwd() + "-moved")


def test_a_node_without_the_working_tree_is_told(machine, tmp_path, monkeypatch):
    tree = tmp_path / "tree"
    tree.mkdir()
    monkeypatch.chdir(tree)
    one_at_a_time = dataclasses.replace(machine, workers=1)
    with pytest.raises(UserError, match=f"{tree} is missing on node .*: all nodes need the working tree"):
        list(pool.map_jobs(move_away, [(), ()], one_at_a_time))


def sleep_with_pid(folder, number):
    write_text(folder / str(number), str(os.getpid()))
    time.sleep(0 if number == 0 else 60)


def test_leaving_the_loop_ends_the_jobs(machine, tmp_path):
    results = pool.map_jobs(sleep_with_pid, [(tmp_path, i) for i in range(3)], machine)
    next(results)
    wait(lambda: len(list(tmp_path.iterdir())) == 3)
    results.close()
    pids = [int((tmp_path / name).read_text()) for name in "12"]
    wait(lambda: not any(psutil.pid_exists(pid) for pid in pids))


def in_background(function, *arguments):
    """A thread that runs `function`, and the list that it puts an exception into."""
    errors = []

    def run():
        try:
            function(*arguments)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, errors


def simulates(node):
    """Whether a worker of a node has loaded the simulator."""
    raylet = psutil.Process(node.all_processes["raylet"][0].process.pid)
    maps = [Path(f"/proc/{worker.pid}/maps") for worker in raylet.children(recursive=True)]
    return any("pybullet" in path.read_text() for path in maps if path.exists())


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def told(smoke, tmp_path, monkeypatch):
    """Recipes of a cell of two seeds, large enough to be caught in the middle; in an empty working directory."""
    cell, found = smoke.cell(ENVIRONMENT, METHOD), dict(resolve.recipes(smoke))
    job, evaluation = cell.train.first, dataclasses.replace(cell.evaluate.evaluation, max_actions=120)
    optimization = dataclasses.replace(job.config.optimization, steps=300)
    job = dataclasses.replace(job, config=dataclasses.replace(job.config, optimization=optimization))
    trials = found[f"trials/{ENVIRONMENT}"]
    monkeypatch.chdir(tmp_path)
    return types.SimpleNamespace(
        collect=found[f"collect/{ENVIRONMENT}"],
        trials=dataclasses.replace(trials, settings=dataclasses.replace(trials.settings, evaluation=evaluation)),
        train=dataclasses.replace(cell.train, first=job),
        evaluate=dataclasses.replace(cell.evaluate, evaluation=evaluation),
    )


def test_with_a_node_killed_twice_the_bytes_are_the_process_pools(cluster, machine, told, tmp_path):
    """The first time in the middle of training, the second time in the middle of rollouts."""
    collect(told.collect, machine)
    both = tmp_path / "both"
    both.mkdir()
    list(pool.map_jobs(describe, [(both, 0), (both, 1)], machine))  # now no seed waits for a worker's start
    thread, errors = in_background(train_cell, told.train, machine)
    wait(lambda: len(list(Path(".scratch").glob("*/state.safetensors"))) == 2)
    kill_second_node(cluster)
    assert not list(Path(".scratch").glob("*/seed*")), "both nodes were in the middle"
    second = cluster.add_node(**NODE)
    make_trials(told.trials, machine)
    thread.join()
    assert not list(Path(".scratch").glob("*/*"))

    import ray

    wait(lambda: ray.available_resources().get("CPU") == 2)
    thread, evaluation_errors = in_background(evaluate_cell, told.evaluate, machine)
    wait(lambda: simulates(second))
    time.sleep(0.5)
    kill_second_node(cluster)
    assert thread.is_alive()
    cluster.add_node(**NODE)
    thread.join()
    assert errors + evaluation_errors == []

    outputs = [Path(name) for name in ("data", "models", "curves", "results")]
    from_ray = [contents(folder) for folder in outputs]
    here = Machine(workers=2, device="cpu")
    collect(told.collect, here)
    make_trials(told.trials, here)
    train_cell(told.train, here)
    evaluate_cell(told.evaluate, here)
    assert [contents(folder) for folder in outputs] == from_ray
    assert all(from_ray)


def test_ctrl_c_is_one_line_and_ends_the_jobs(cluster, told, tmp_path):
    """The stage as the pipeline runs it, in a process of its own."""
    workspace = Workspace.fresh(tmp_path)
    workspace.machine(engine="ray", device="cpu", ray_address=cluster.address, save_seconds=0)
    workspace.set(f"methods.{METHOD}.train.{ENVIRONMENT}.optimization.steps", 100_000)
    workspace.python("-m", "stages", "resolve")
    collect(told.collect, Machine(workers=1, device="cpu"))
    process = workspace.start(sys.executable, "-m", "stages", "train", ENVIRONMENT, METHOD)
    wait(lambda: len(list(tmp_path.glob(".scratch/*/state.safetensors"))) == 2)
    os.killpg(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 130
    assert output.count("\n") == 1
    assert output.startswith("interrupted; run the same command again")
    before = contents(tmp_path / ".scratch")
    time.sleep(1)
    assert contents(tmp_path / ".scratch") == before, "nobody trains any more"
