"""`python -m pipeline.run -j N [STAGE ...]` is `dvc repro` with up to N independent stages side by side.

Every stage runs as `dvc repro --single-item` in a process of its own, after all stages it depends on. DVC decides what
really runs, and writes dvc.lock; in a new one the stages stand in the order in which they ended.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time

from dvc.exceptions import DvcException
from dvc.repo import Repo
from dvc.repo.reproduce import collect_stages, get_active_graph, plan_repro

from beso.errors import UserError
from pipeline import paths
from pipeline.stage import guard

LOGS = paths.SCRATCH / "logs"
LAST_LINES = 12  # of the output of a stage that failed


def plan(targets: list[str]) -> tuple[dict[str, set[str]], set[str]]:
    """Addresses of the stages of `dvc repro TARGETS` that are out of date or follow such a one.

    Returns:
        Each with those among them that it waits for, the one with the longest chain of others behind it first. And
        those that run last, alone: they measure time (`meta: {alone: true}` in dvc.yaml).

    Raises:
        UserError: no such stage, or DVC cannot read its files.
    """
    try:
        with Repo() as repo:
            graph = get_active_graph(repo.index.graph)
            stages = plan_repro(graph, collect_stages(repo, targets or ["dvc.yaml"]))
            stale = repo.status()
    except DvcException as error:
        raise UserError(str(error)) from None
    waits_for: dict[str, set[str]] = {}
    for stage in stages:  # in topological order
        before = {upstream.addressing for upstream in graph.successors(stage)} & waits_for.keys()
        if before or stage.addressing in stale:
            waits_for[stage.addressing] = before
    behind = dict.fromkeys(waits_for, 0)
    for name in reversed(waits_for):
        for upstream in waits_for[name]:
            behind[upstream] = max(behind[upstream], behind[name] + 1)
    alone = {stage.addressing for stage in stages if (stage.meta or {}).get("alone")}
    return {name: waits_for[name] for name in sorted(waits_for, key=lambda name: -behind[name])}, alone


class Child:
    """One stage in a process group of its own, its output in a file."""

    def __init__(self, name: str, workers: int) -> None:
        self.name, self.start, self.processor = name, time.monotonic(), 0.0
        self.log = LOGS / f"{name}.log"
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "dvc", "--wait-for-lock", "repro", "--single-item", name],
                env={**os.environ, "BESO_WORKERS": str(workers)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # so that Ctrl-C comes once, from `interrupt`
                # A shell without job control lets what runs in its background ignore it, and so what that starts.
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            )

    def interrupt(self) -> None:
        """As Ctrl-C on a terminal: also to the stage's command, while which runs DVC ignores it."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)

    def ended(self) -> bool:
        """Whether it has ended; `processor` is then what it and all its processes used, in seconds."""
        if self.process.returncode is None:
            pid, status, usage = os.wait4(self.process.pid, os.WNOHANG)
            if pid:
                self.process.returncode = os.waitstatus_to_exitcode(status)
                self.processor = usage.ru_utime + usage.ru_stime
        return self.process.returncode is not None

    def time(self) -> str:
        """Minutes and seconds since it started."""
        return _minutes(time.monotonic() - self.start)

    def failure(self) -> str:
        """What to tell the user: the stage, where its output is, and the end of that."""
        last = self.log.read_text(errors="replace").splitlines()[-LAST_LINES:]
        return "\n    ".join([f"{self.name} failed after {self.time()}; the end of {self.log}:", *last])


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


def execute(waits_for: dict[str, set[str]], alone: set[str], jobs: int, cores: int) -> tuple[list[str], list[str]]:
    """Run stages, up to `jobs` at once.

    Args:
        waits_for, alone: see `plan`.
        cores: shared among the stages that run at one time.

    Returns:
        The stages that failed, and those that did not run because they wait for one that failed.
    """
    waiting, done, failed = dict(waits_for), set[str](), list[str]()
    running: list[Child] = []
    progress = Progress(len(waiting))
    try:
        while True:
            for child in [c for c in running if c.ended()]:
                running.remove(child)
                if child.process.returncode == 0:
                    done.add(child.name)
                    progress.event(f"{child.name} done in {child.time()}, {_minutes(child.processor)} of processor")
                else:
                    failed.append(child.name)
                    progress.show(child.failure())
            can_run = [name for name, before in waiting.items() if before <= done]
            ready = [name for name in can_run if name not in alone][: jobs - len(running)]
            if any(child.name in alone for child in running):
                ready = []
            elif not running and not ready:
                ready = can_run[:1]
            workers = max(1, cores // max(1, len(running) + len(ready)))
            for name in ready:
                del waiting[name]
                running.append(Child(name, workers))
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
            child.process.wait()


def main(*arguments: str) -> None:
    parser = argparse.ArgumentParser(prog="python -m pipeline.run", description="dvc repro, stages side by side")
    parser.add_argument("-j", "--jobs", type=int, default=2, help="stages at a time (default: %(default)s)")
    parser.add_argument("stages", nargs="*", metavar="STAGE", help="these and what they need, as for dvc repro")
    options = parser.parse_args(arguments)
    if options.jobs < 1:
        parser.error("argument -j/--jobs: must be at least 1")
    todo, alone = plan(options.stages)
    if not todo:
        print("everything is up to date")
        return
    from pipeline.pool import available_workers  # imports torch; a run with nothing to do need not wait for that

    for number in (signal.SIGTERM, signal.SIGHUP):  # in their own process groups the stages would go on
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores the second
            signal.signal(number, signal.default_int_handler)
    failed, skipped = execute(todo, alone, options.jobs, available_workers())
    if failed:
        raise UserError(f"failed: {', '.join(failed)}" + (f"; not run: {', '.join(skipped)}" if skipped else ""))
    if stale := plan(options.stages)[0]:
        raise UserError(f"still out of date: {', '.join(stale)}; something changed meanwhile, run again")
    print(f"{len(todo)} stages brought up to date")


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
