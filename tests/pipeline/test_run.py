"""The parallel runner on throw-away DVC repositories with trivial commands."""

import fcntl
import os
import pty
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from beso.errors import UserError
from pipeline.machine import available_workers

ROOT = Path(__file__).parents[2]
NAP = 1.5  # seconds; long beside DVC's start, so that stages that may overlap do

# a -> left, right -> end; every stage notes when its command started and ended, and its share of the cores.
STAGES = """
stages:
  a:
    cmd: sh step a && cat seed > a
    deps: [seed, step]
    outs: [a]
  side:
    matrix:
      which: [left, right]
    cmd: sh step ${item.which} && cat a > ${item.which}
    params: ["version.${item.which}"]
    deps: [a, step]
    outs: ["${item.which}"]
  end:
    cmd: sh step end && cat left right > end
    deps: [left, right, step]
    outs: [end]
  other:
    cmd: sh step other && echo other > other
    deps: [step]
    outs: [other]
"""
# The trap comes before the event that tests wait for, and `wait` ends with it: with `sleep` in the foreground, an
# interrupt between the shell's fork and its start would be lost.
STEP = """
trap 'echo "$1 interrupted" >> events; kill $! 2>/dev/null; exit 130' INT
echo "$1 start $(date +%s.%N) $BESO_WORKERS" >> events
if [ -e "fail_$1" ]; then echo "no luck" >&2; exit 3; fi
sleep $(cat nap_$1 || cat nap || echo 0) 2>/dev/null &
wait $!
echo "$1 end $(date +%s.%N)" >> events
"""


class Repository:
    def __init__(self, folder):
        self.folder = folder

    @classmethod
    def fresh(cls, folder):
        folder.mkdir()
        repository = cls(folder)
        repository.write("dvc.yaml", STAGES)
        repository.write("params.yaml", "version: {left: 1, right: 1}\n")
        repository.write("step", STEP)
        repository.write("seed", "1\n")
        repository.call("git", "init", "-q")
        repository.call(sys.executable, "-m", "dvc", "init", "-q")
        return repository

    def write(self, name, text):
        (self.folder / name).write_text(text)

    def command(self, *arguments):
        return [sys.executable, "-m", "pipeline.cli", "run", *arguments]

    @property
    def environment(self):
        # Without DVC_NO_ANALYTICS every command leaves a process behind that reports it to DVC's makers.
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "SHELL": "/bin/sh", "DVC_NO_ANALYTICS": "1"}
        environment.pop("BESO_WORKERS", None)
        return environment

    def call(self, *command, code=0):
        """Both outputs of a command."""
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = subprocess.run(command, cwd=self.folder, env=self.environment, **streams)
        assert done.returncode == code, done.stdout
        return done.stdout

    def run(self, *arguments, code=0):
        (self.folder / "events").unlink(missing_ok=True)
        return self.call(*self.command(*arguments), code=code)

    def start(self, *arguments, interrupts=signal.SIG_DFL, **streams):
        return subprocess.Popen(
            self.command(*arguments),
            cwd=self.folder,
            env=self.environment,
            **streams,
            preexec_fn=lambda: signal.signal(signal.SIGINT, interrupts),
        )

    def events(self):
        path = self.folder / "events"
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    def started(self):
        return [name for name, what, *_ in self.events() if what == "start"]

    def time(self, name, what):
        return next(float(values[0]) for n, w, *values in self.events() if (n, w) == (name, what))

    def lock(self):
        return YAML(typ="safe").load((self.folder / "dvc.lock").read_text())


@pytest.fixture
def repository(tmp_path):
    return Repository.fresh(tmp_path / "repository")


def in_seconds(names, repository):
    """Sorted times of start and of end of stages."""
    return [sorted(repository.time(name, what) for name in names) for what in ("start", "end")]


def test_order_overlap_shares_lock_and_what_reruns(repository, tmp_path):
    names = ("a", "left", "right", "end", "other")
    repository.write("nap", str(NAP))
    output = repository.run("-j", "2")
    for earlier, later in [("a", "left"), ("a", "right"), ("left", "end"), ("right", "end")]:
        assert repository.time(earlier, "end") < repository.time(later, "start")
    starts, ends = in_seconds(names, repository)
    at_once = [sum(s <= now for s in starts) - sum(e < now for e in ends) for now in starts]
    assert max(at_once) == 2, "side by side, but never more than asked for"
    shares = {name: int(values[1]) for name, what, *values in repository.events() if what == "start"}
    cores = len(os.sched_getaffinity(0))
    assert shares["a"] == shares["other"] == shares["left"] == max(1, cores // 2)
    assert output.index("a started") < output.index("other started"), "the longest chain of others waits for it"
    assert output.count(" started\n") == output.count(" done in 0:0") == 5
    assert "5 stages brought up to date" in output

    sequential = Repository.fresh(tmp_path / "sequential")
    sequential.call(sys.executable, "-m", "dvc", "repro")
    assert repository.lock() == sequential.lock()
    for name in names:
        assert (repository.folder / name).read_bytes() == (sequential.folder / name).read_bytes()

    before = (repository.folder / "dvc.lock").read_bytes()
    assert repository.run() == "everything is up to date\n"
    assert not repository.events()
    assert (repository.folder / "dvc.lock").read_bytes() == before

    (repository.folder / "nap").unlink()
    repository.write("params.yaml", "version: {left: 2, right: 1}\n")
    output = repository.run()
    assert repository.started() == ["left"], "its output is as before: DVC skips the end"
    assert "2 stages brought up to date" in output
    assert (repository.folder / "dvc.lock").read_bytes() != before


def test_targets_run_with_what_they_need(repository):
    repository.run("side@left")
    assert repository.started() == ["a", "left"]
    repository.run("side", "other")
    assert sorted(repository.started()) == ["other", "right"]
    assert "error: " in repository.run("nonsense", code=1)
    assert "0 is not in the range x>=1" in repository.run("-j", "0", code=2)


def test_a_folder_that_git_does_not_know_is_told_what_makes_it_known(repository):
    shutil.rmtree(repository.folder / ".git")
    told = repository.run(code=1)
    assert told == f"error: {repository.folder} is not a git repository; DVC needs one: `git init` makes it\n"


def test_another_run_of_other_targets_is_left_alone(repository):
    repository.write("nap_other", "60")
    command = [sys.executable, "-m", "dvc", "repro", "other"]
    settings = {"cwd": repository.folder, "env": repository.environment, "start_new_session": True}
    listens = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731 (a background job ignores Ctrl-C)
    other = subprocess.Popen(command, **settings, stderr=subprocess.DEVNULL, preexec_fn=listens)
    try:
        wait_for(repository, 1)
        assert "3 stages brought up to date" in repository.call(*repository.command("side"))
        assert sorted(repository.started()) == ["a", "left", "other", "right"]
        assert "is busy" in repository.call(*repository.command("other"), code=1)
    finally:
        os.killpg(other.pid, signal.SIGINT)
    assert other.wait() != 0
    assert set(repository.lock()["stages"]) == {"a", "side@left", "side@right"}


def test_it_works_from_a_subfolder(repository):
    folder = repository.folder / "some/where"
    folder.mkdir(parents=True)
    command = repository.command("side@left")
    subprocess.run(command, cwd=folder, env=repository.environment, check=True, capture_output=True)
    assert repository.started() == ["a", "left"]


def test_a_failing_stage_stops_only_what_needs_it_and_the_next_run_continues(repository):
    repository.write("fail_left", "")
    output = repository.run(code=1)
    assert sorted(repository.started()) == ["a", "left", "other", "right"]
    assert "side@left failed after 0:0" in output
    assert ".scratch/logs/side@left.log" in output
    assert "    no luck\n" in output
    assert output.splitlines()[-1] == "error: failed: side@left; not run: end"
    assert "no luck" in (repository.folder / ".scratch/logs/side@left.log").read_text()
    (repository.folder / "fail_left").unlink()
    repository.run()
    assert repository.started() == ["left", "end"]


def wait_for(repository, stages, seconds=20):
    """Until so many stages have started."""
    deadline = time.monotonic() + seconds
    while len(repository.started()) < stages:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_what_measures_time_runs_alone(repository):
    repository.write("dvc.yaml", STAGES.replace("  other:\n", "  other:\n    meta: {alone: true}\n"))
    repository.write("nap", str(NAP))
    repository.run("-j", "3")
    names = ("a", "left", "right", "end")
    start, end = repository.time("other", "start"), repository.time("other", "end")
    assert all(end < repository.time(name, "start") or repository.time(name, "end") < start for name in names)
    assert repository.time("right", "start") < repository.time("left", "end")
    assert repository.time("left", "start") < repository.time("right", "end")


def test_an_input_that_changes_during_the_run_is_told(repository):
    repository.write("nap_left", str(NAP))
    process = repository.start("side@left", stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    wait_for(repository, 2)
    repository.write("seed", "3\n")
    output, _ = process.communicate()
    assert process.returncode == 1
    assert "error: still out of date: a, side@left; something changed meanwhile" in output


@pytest.mark.parametrize("in_background", [False, True])
def test_ctrl_c_ends_the_stages_and_the_next_run_continues(repository, in_background):
    """In the background of a script, where Ctrl-C is ignored, it is SIGTERM that ends them."""
    repository.write("nap_left", "60")
    repository.write("nap_right", "60")
    interrupts = signal.SIG_IGN if in_background else signal.SIG_DFL
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = repository.start("side", interrupts=interrupts, **streams)
    wait_for(repository, 3)
    start = time.monotonic()
    # To the runner alone: the stages are in groups of their own.
    process.send_signal(signal.SIGTERM if in_background else signal.SIGINT)
    _, errors = process.communicate()
    assert time.monotonic() - start < 20
    assert process.returncode == 130
    assert sorted(name for name, what, *_ in repository.events() if what == "interrupted") == ["left", "right"]
    assert errors.splitlines()[-1].startswith("interrupted; ")
    assert errors.count("interrupted") == 1
    (repository.folder / "nap_left").unlink()
    repository.run("side@left")
    assert repository.started() == ["left"]


def test_a_terminal_shows_one_line_that_changes(repository):
    repository.write("nap", str(NAP))
    parent, child = pty.openpty()
    fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    process = repository.start("side", stdin=child, stdout=child, stderr=child)
    os.close(child)
    output = b""
    while True:
        try:
            output += os.read(parent, 4096)
        except OSError:  # how a terminal on Linux ends
            break
    assert process.wait() == 0
    os.close(parent)
    text = output.decode()
    assert "0 of 3 stages done; a 0:01" in text
    assert "1 of 3 stages done; side@left 0:01, side@right 0:01" in text
    assert text.count("\n") == 1, "the last line alone stays"


def test_workers_are_the_share_that_the_runner_gives(monkeypatch):
    monkeypatch.delenv("BESO_WORKERS", raising=False)
    assert available_workers() == len(os.sched_getaffinity(0))
    monkeypatch.setenv("BESO_WORKERS", "7")
    assert available_workers() == 7
    for share in ("0", "-3", "many"):
        monkeypatch.setenv("BESO_WORKERS", share)
        with pytest.raises(UserError, match=f"^BESO_WORKERS = {share}: must be a number of workers, at least 1$"):
            available_workers()
