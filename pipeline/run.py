"""`beso run` is `dvc repro` with some independent stages side by side.

Each stage is run by DVC's own command, `dvc repro --single-item STAGE`, after all stages that it depends on. DVC
decides what really runs; in a new dvc.lock the stages stand in the order in which they ended.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from dvc.exceptions import DvcException
from dvc.repo import Repo
from dvc.repo.reproduce import collect_stages, get_active_graph, plan_repro
from dvc.scm import SCMError
from tqdm import tqdm

from beso.errors import UserError
from pipeline import paths
from pipeline.machine import available_workers

LOGS = paths.SCRATCH / "logs"
INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
LAST_LINES = 12  # of the output of a stage that failed
REPRODUCE = (sys.executable, "-m", "dvc", "--wait-for-lock", "repro", "--single-item")


@dataclass(frozen=True)
class Step:
    """A stage that is out of date or follows such a one.

    Attributes:
        waits_for: names of the steps that it waits for.
        alone: whether it measures time, so that it runs last and alone (`meta: {alone: true}` in dvc.yaml).
        first: whether all others are planned when it is done (`meta: {first: true}`): few of them may be out of date.
    """

    waits_for: set[str]
    alone: bool
    first: bool


def plan(targets: Sequence[str]) -> dict[str, Step]:
    """What `dvc repro TARGETS` may run, by name; the one with the longest chain of others behind it first.

    Raises:
        UserError: no such stage, or DVC cannot read its files.
    """
    try:
        with Repo(_wait_for_lock=True) as repo, repo.lock:
            graph = get_active_graph(repo.index.graph)
            stages = plan_repro(graph, collect_stages(repo, targets or ["dvc.yaml"]))  # in topological order
            stale = {stage.addressing for stage in stages if stage.status()}
    except SCMError as error:
        raise UserError(f"{error}; DVC needs one: `git init` makes it") from None
    except DvcException as error:
        raise UserError(str(error)) from None
    steps: dict[str, Step] = {}
    for stage in stages:
        before = {upstream.addressing for upstream in graph.successors(stage)} & steps.keys()
        if before or stage.addressing in stale:
            steps[stage.addressing] = Step(before, *(bool((stage.meta or {}).get(key)) for key in ("alone", "first")))
    behind = dict.fromkeys(steps, 0)
    for name in reversed(steps):
        for upstream in steps[name].waits_for:
            behind[upstream] = max(behind[upstream], behind[name] + 1)
    return {name: steps[name] for name in sorted(steps, key=lambda name: -behind[name])}


class Child:
    """DVC's command for one stage, in a process group of its own, its output in a file."""

    def __init__(self, name: str, workers: int) -> None:
        self.name, self.start, self.log = name, time.monotonic(), LOGS / f"{name}.log"
        # The stage's `python` is the one that runs this, also where the environment is not activated.
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("w") as output:
            self.process = subprocess.Popen(
                [*REPRODUCE, name],
                env={**os.environ, "PATH": path, "BESO_WORKERS": str(workers)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C comes once, from `interrupt`
            )

    def interrupt(self) -> None:
        """As Ctrl-C on a terminal, which reaches the stage's command too. DVC ignores it while that runs."""
        if self.process.returncode is None:
            os.killpg(self.process.pid, signal.SIGINT)

    def ended(self, options: int = os.WNOHANG) -> bool:
        """Whether it has ended; `processor` is then what all its processes used, in seconds."""
        if self.process.returncode is None:
            pid, status, usage = os.wait4(self.process.pid, options)
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


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let signals that come meanwhile act at the end, so that no stage starts or ends unnoticed."""
    came: list[int] = []
    handlers = {number: signal.signal(number, lambda number, _: came.append(number)) for number in INTERRUPTS}
    try:
        yield
    finally:
        for which, handler in handlers.items():
            signal.signal(which, handler)
        for number in came:
            signal.raise_signal(number)


def _minutes(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def execute(steps: dict[str, Step], jobs: int, cores: int) -> tuple[list[str], list[str]]:
    """Run stages, up to `jobs` at once: one line that changes on a terminal, elsewhere one at each start and end.

    Args:
        steps: see `plan`.
        cores: shared among the stages that run at one time.

    Returns:
        The stages that failed, and those that did not run because they wait for one that failed.
    """
    waiting, done, failed, running = dict(steps), set[str](), list[str](), list[Child]()
    shown = "{n} of {total} stages done; {desc}"
    with tqdm(total=len(steps), bar_format=shown, leave=False, dynamic_ncols=True, disable=None) as progress:

        def tell(text: str, lasting: bool = False) -> None:
            if lasting or progress.disable:
                tqdm.write(text, file=sys.stderr)

        try:
            while True:
                with _uninterrupted():
                    for child in [c for c in running if c.ended()]:
                        running.remove(child)
                        if child.process.returncode == 0:
                            done.add(child.name)
                            progress.update()
                            tell(f"{child.name} done in {child.time()}, {_minutes(child.processor)} of processor")
                        else:
                            failed.append(child.name)
                            tell(child.failure(), lasting=True)
                    can_run = [name for name, step in waiting.items() if step.waits_for <= done]
                    ready = [name for name in can_run if not steps[name].alone][: jobs - len(running)]
                    if any(steps[child.name].alone for child in running):
                        ready = []
                    elif not running and not ready:
                        ready = can_run[:1]
                    workers = max(1, cores // max(1, len(running) + len(ready)))
                    for name in ready:
                        del waiting[name]
                        running.append(Child(name, workers))
                        tell(f"{name} started")
                    if not running:
                        return failed, list(waiting)
                    progress.set_description_str(", ".join(f"{c.name} {c.time()}" for c in running))
                time.sleep(0.1)
        finally:
            for child in running:
                child.interrupt()
            for child in running:
                child.ended(options=0)  # waits for it


def run(targets: Sequence[str], jobs: int) -> None:
    """Bring targets up to date, and what they need.

    Raises:
        UserError: as `plan`; a stage failed; or something changed meanwhile.
    """
    todo = plan(targets)
    if not todo:
        print("everything is up to date")
        return
    for number in (signal.SIGTERM, signal.SIGHUP):  # in their own sessions the stages would go on
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores the second
            signal.signal(number, signal.default_int_handler)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in a script's background, and so would the stages
        signal.signal(signal.SIGINT, lambda *_: None)
    done = 0
    for steps in ({name: step for name, step in todo.items() if step.first}, todo):
        if done:
            steps = plan(targets)  # what the first ones wrote decides
        failed, skipped = execute(steps, jobs, available_workers())
        if failed:
            raise UserError(f"failed: {', '.join(failed)}" + (f"; not run: {', '.join(skipped)}" if skipped else ""))
        done += len(steps)
    if stale := plan(targets):
        raise UserError(f"still out of date: {', '.join(stale)}; something changed meanwhile, run again")
    print(f"{done} {'stage' if done == 1 else 'stages'} brought up to date")
