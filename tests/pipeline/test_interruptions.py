"""Killed, interrupted and starved of disk: nothing is lost and the next run continues."""

import os
import random
import resource
import signal
import sys
import time

import pytest

TRAIN = (sys.executable, "-m", "stages", "train", "block_push", "c_beso")


def wait_for_state(workspace, since=0.0, timeout=240):
    """Until a training saved its state after `since`; its time of change."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        times = [path.stat().st_mtime for path in workspace.folder.glob(".scratch/*/state.safetensors")]
        if times and max(times) > since:
            return max(times)
        time.sleep(0.02)
    pytest.fail("no training state was saved")


def slow(workspace, env, method):
    """One seed, enough steps to be caught in the middle, state saved after every step."""
    workspace.set(f"environments.{env}.seeds", [1])
    workspace.set(f"methods.{method}.train.{env}.optimization.steps", 400)
    workspace.machine(save_seconds=0)
    workspace.python("-m", "stages", "resolve")
    return workspace


@pytest.mark.parametrize(("env", "method"), [("block_push", "c_beso"), ("kitchen", "c_bet")])
def test_killed_five_times_and_resumed_gives_the_undisturbed_checkpoint(workspace, tmp_path, env, method):
    train = (*TRAIN[:-2], env, method)
    slow(workspace, env, method)
    undisturbed = workspace.copy(tmp_path / "undisturbed")
    undisturbed.run(*train)
    rng, last = random.Random(0), 0.0
    for _ in range(5):
        process = workspace.start(*train)
        last = wait_for_state(workspace, last)
        time.sleep(rng.uniform(0, 0.4))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    output = workspace.run(*train).stdout
    assert "continuing at step" in output
    assert workspace.files("models", "curves") == undisturbed.files("models", "curves")
    left = {path.name for path in workspace.folder.glob(".scratch/*")}
    assert left <= {"logs"}  # those of the run that made this copy


def test_ctrl_c_is_one_line_and_the_next_repro_continues(small):
    slow(small, "block_push", "c_beso")
    before = small.files("data", "results", "reports")
    process = small.start("dvc", "repro", "train@block_push-c_beso")
    wait_for_state(small)
    os.killpg(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=240)
    assert process.returncode != 0
    assert output.count("interrupted; run the same command again") == 1
    assert "Traceback" not in output
    assert small.files("data", "results", "reports") == before
    output = small.dvc("repro", "train@block_push-c_beso").stdout
    assert "continuing at step" in output


@pytest.mark.parametrize(
    ("command", "limit", "kept"),
    [
        (TRAIN, 20_000, ("data", "models", "curves", "results", "reports")),
        ((sys.executable, "-m", "stages", "collect", "block_push"), 50_000, ("data", "models", "results", "reports")),
        ((sys.executable, "-m", "stages", "tables"), 5_000, ("data", "models", "results")),
    ],
)
def test_a_full_disk_is_one_line_and_replaces_nothing(small, command, limit, kept):
    """A limit on the size of files stands for the full disk: writing fails half-way in the same place."""
    small.machine(workers=2)
    small.set("environments.block_push.training.validation.every", 30)
    small.python("-m", "stages", "resolve")
    before = small.files(*kept)
    done = small.run(
        *command,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 1
    assert "error: File too large" in done.stdout
    assert "Traceback" not in done.stdout
    assert small.files(*kept) == before
    assert not [path for path in small.folder.rglob("*.partial") if ".dvc" not in path.parts]
    small.run(*command)
