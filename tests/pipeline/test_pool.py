import os

import pytest
import torch

from beso.errors import UserError
from pipeline.pool import map_jobs


def threads_and_square(x):
    return torch.get_num_threads(), x * x, os.getpid()


def fail(x):
    if x == 2:
        raise UserError("job 2 is wrong")
    return x


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs_from_one_thread_each(workers):
    results = list(map_jobs(threads_and_square, [(i,) for i in range(6)], workers))
    assert [square for _, square, _ in results] == [0, 1, 4, 9, 16, 25]
    assert {threads for threads, _, _ in results} == {1}
    assert (os.getpid() in {pid for _, _, pid in results}) == (workers == 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_in_a_job_reaches_the_caller(workers):
    with pytest.raises(UserError, match="job 2 is wrong"):
        list(map_jobs(fail, [(i,) for i in range(4)], workers))


def test_no_jobs_give_no_results():
    assert list(map_jobs(fail, [], 2)) == []
