"""`python -m pipeline.run -j N [STAGE ...]` is `dvc repro` with up to N independent stages side by side.

Every stage runs as by `dvc repro --single-item`, in a process of its own, after all stages it depends on. DVC decides
what really runs; in a new dvc.lock the stages stand in the order in which they ended.
"""

import argparse
import os
import shutil
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from dvc.exceptions import DvcException
from dvc.repo import Repo
from dvc.repo.reproduce import collect_stages, get_active_graph, plan_repro
from dvc.stage import PipelineStage
from tqdm import tqdm

from beso.errors import UserError
from pipeline import paths
from pipeline.reproduction import reproduce
from pipeline.stage import guard

LOGS = paths.SCRATCH / "logs"
WRITING = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
LAST_LINES = 12  # of the output of a stage that failed


@dataclass(frozen=True)
class Step:
    """A stage that is out of date or follows such a one.

    Attributes:
        waits_for: names of the steps that it waits for.
        alone: whether it measures time, so that it runs last and alone (`meta: {alone: true}` in dvc.yaml).
    """

    stage: PipelineStage
    waits_for: set[str]
    alone: bool


def plan(targets: list[str]) -> dict[str, Step]:
    """What `dvc repro TARGETS` may run, by name; the one with the longest chain of others behind it first.

    Raises:
        UserError: no such stage, or DVC cannot read its files.
    """
    tqdm.monitor_interval = 0  # without its thread this process can fork
    try:
        with Repo(_wait_for_lock=True) as repo:
            graph = get_active_graph(repo.index.graph)
            stages = plan_repro(graph, collect_stages(repo, targets or ["dvc.yaml"]))
            stale = repo.status()
    except DvcException as error:
        raise UserError(str(error)) from None
    steps: dict[str, Step] = {}
    for stage in stages:  # in topological order
        before = {upstream.addressing for upstream in graph.successors(stage)} & steps.keys()
        if before or stage.addressing in stale:
            steps[stage.addressing] = Step(stage, before, bool((stage.meta or {}).get("alone")))
    behind = dict.fromkeys(steps, 0)
    for name in reversed(steps):
        for upstream in steps[name].waits_for:
            behind[upstream] = max(behind[upstream], behind[name] + 1)
    return {name: steps[name] for name in sorted(steps, key=lambda name: -behind[name])}


class Child:
    """One stage in a process group of its own, its output in a file."""

    def __init__(self, stage: PipelineStage, workers: int) -> None:
        self.name, self.start, self.processor = stage.addressing, time.monotonic(), 0.0
        self.log = LOGS / f"{self.name}.log"
        self.log.parent.mkdir(parents=True, exist_ok=True)
        self.code: int | None = None
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if not self.pid:
            _become(stage, workers, self.log)
        os.setpgid(self.pid, self.pid)  # as the child does itself; whoever is first, `interrupt` finds the group

    def interrupt(self) -> None:
        """As Ctrl-C on a terminal: also to the stage's command, while which runs DVC ignores it."""
        if self.code is None:
            os.killpg(self.pid, signal.SIGINT)

    def wait(self) -> None:
        """Until it has ended."""
        if self.code is None:
            os.waitpid(self.pid, 0)

    def ended(self) -> bool:
        """Whether it has ended; `code` is then its exit code, `processor` what all its processes used, in seconds."""
        if self.code is None:
            pid, status, usage = os.wait4(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
                self.processor = usage.ru_utime + usage.ru_stime
        return self.code is not None

    def time(self) -> str:
        """Minutes and seconds since it started."""
        return _minutes(time.monotonic() - self.start)

    def failure(self) -> str:
        """What to tell the user: the stage, where its output is, and the end of that."""
        last = self.log.read_text(errors="replace").splitlines()[-LAST_LINES:]
        return "\n    ".join([f"{self.name} failed after {self.time()}; the end of {self.log}:", *last])


def _become(stage: PipelineStage, workers: int, log: Path) -> NoReturn:
    """Make a forked process one that runs a stage, and end it. Its input is empty, its output goes to `log`."""
    code = 1
    try:
        os.setpgid(0, 0)  # so that Ctrl-C comes once, from `Child.interrupt`
        # A shell without job control lets what runs in its background ignore it, and so what that starts.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        for number, opened in ((0, os.open(os.devnull, os.O_RDONLY)), (1, os.open(log, WRITING)), (2, 1)):
            os.dup2(opened, number)
        os.environ["BESO_WORKERS"] = str(workers)
        reproduce(stage)
        code = 0
    except DvcException as error:
        print(f"error: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # what the parent has registered for its end is not done here


def _minutes(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


class Progress:
    """One line that changes, on a terminal; elsewhere a line whenever a stage starts or ends."""

    def __init__(self, total: int) -> None:
        self.total, self.terminal = total, sys.stderr.isatty()

    def show(self, text: str, end: str = "\n") -> None:
        """A lasting line, or with another `end` the one that changes."""
        clear = "\r\x1b[K" if self.terminal else ""
        print(clear + text, end=end, file=sys.stderr, flush=True)

    def event(self, text: str) -> None:
        """A stage started or ended."""
        if not self.terminal:
            self.show(text)

    def update(self, done: int, running: list[Child]) -> None:
        """Where things stand now."""
        if self.terminal:
            text = f"{done} of {self.total} stages done; " + ", ".join(f"{c.name} {c.time()}" for c in running)
            self.show(text[: shutil.get_terminal_size().columns - 1], end="")  # a full line would scroll

    def close(self) -> None:
        """Clear the line that changes."""
        if self.terminal:
            self.show("", end="")


def execute(steps: dict[str, Step], jobs: int, cores: int) -> tuple[list[str], list[str]]:
    """Run stages, up to `jobs` at once.

    Args:
        steps: see `plan`.
        cores: shared among the stages that run at one time.

    Returns:
        The stages that failed, and those that did not run because they wait for one that failed.
    """
    waiting, done, failed = dict(steps), set[str](), list[str]()
    running: list[Child] = []
    progress = Progress(len(waiting))
    try:
        while True:
            for child in [c for c in running if c.ended()]:
                running.remove(child)
                if child.code == 0:
                    done.add(child.name)
                    progress.event(f"{child.name} done in {child.time()}, {_minutes(child.processor)} of processor")
                else:
                    failed.append(child.name)
                    progress.show(child.failure())
            can_run = [name for name, step in waiting.items() if step.waits_for <= done]
            ready = [name for name in can_run if not steps[name].alone][: jobs - len(running)]
            if any(steps[child.name].alone for child in running):
                ready = []
            elif not running and not ready:
                ready = can_run[:1]
            workers = max(1, cores // max(1, len(running) + len(ready)))
            for name in ready:
                running.append(Child(waiting.pop(name).stage, workers))
                progress.event(f"{name} started")
            if not running:
                return failed, list(waiting)
            progress.update(len(done), running)
            time.sleep(0.1)
    finally:
        progress.close()
        for child in running:
            child.interrupt()
        for child in running:
            child.wait()


def main(*arguments: str) -> None:
    parser = argparse.ArgumentParser(prog="python -m pipeline.run", description="dvc repro, stages side by side")
    parser.add_argument("-j", "--jobs", type=int, default=2, help="stages at a time (default: %(default)s)")
    parser.add_argument("stages", nargs="*", metavar="STAGE", help="these and what they need, as for dvc repro")
    options = parser.parse_args(arguments)
    if options.jobs < 1:
        parser.error("argument -j/--jobs: must be at least 1")
    todo = plan(options.stages)
    if not todo:
        print("everything is up to date")
        return
    from pipeline.pool import available_workers  # imports torch; a run with nothing to do need not wait for that

    for number in (signal.SIGTERM, signal.SIGHUP):  # in their own process groups the stages would go on
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores the second
            signal.signal(number, signal.default_int_handler)
    failed, skipped = execute(todo, options.jobs, available_workers())
    if failed:
        raise UserError(f"failed: {', '.join(failed)}" + (f"; not run: {', '.join(skipped)}" if skipped else ""))
    if stale := plan(options.stages):
        raise UserError(f"still out of date: {', '.join(stale)}; something changed meanwhile, run again")
    print(f"{len(todo)} stages brought up to date")


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
