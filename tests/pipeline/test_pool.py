import os
import signal
import time

import pytest
import torch

from beso.errors import UserError
from pipeline.machine import Machine
from pipeline.pool import map_jobs


def threads_and_square(x):
    return torch.get_num_threads(), x * x, os.getpid()


def fail(x):
    if x == 2:
        raise UserError("job 2 is wrong")
    return x


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs_from_one_thread_each(workers):
    results = list(map_jobs(threads_and_square, [(i,) for i in range(6)], Machine(workers=workers)))
    assert [square for _, square, _ in results] == [0, 1, 4, 9, 16, 25]
    assert {threads for threads, _, _ in results} == {1}
    assert (os.getpid() in {pid for _, _, pid in results}) == (workers == 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_in_a_job_reaches_the_caller(workers):
    with pytest.raises(UserError, match="job 2 is wrong"):
        list(map_jobs(fail, [(i,) for i in range(4)], Machine(workers=workers)))


def kill_worker(x):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_worker_is_an_error_and_no_endless_wait():
    with pytest.raises(UserError, match="a worker process was killed"):
        list(map_jobs(kill_worker, [(i,) for i in range(4)], Machine(workers=2)))


def wait_long(x):
    time.sleep(60 * x)


def test_an_abandoned_pool_ends_its_workers():
    start = time.monotonic()
    results = map_jobs(wait_long, [(0,), (1,), (1,)], Machine(workers=2))
    next(results)
    results.close()
    assert time.monotonic() - start < 30


def test_no_jobs_give_no_results():
    assert list(map_jobs(fail, [], Machine(workers=2))) == []
