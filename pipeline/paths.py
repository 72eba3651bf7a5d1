"""Where things live, relative to the repository's root, from where every command runs."""

from pathlib import Path

SCRATCH = Path(".scratch")
REPORTS = Path("reports")
LATENCY = Path("timings/latency.csv")
FORK = Path("results/fork.csv")


def play(environment: str) -> Path:
    """The play dataset."""
    return Path("data/play") / environment


def trials(environment: str) -> Path:
    """The episodes that policies are evaluated on."""
    return Path("data/trials") / environment


def raw(environment: str) -> Path:
    """Raw play of an environment that sees images."""
    return Path("data/raw") / environment


def frames(environment: str) -> Path:
    """Packed frames of an environment that sees images."""
    return Path("data/frames") / environment


def samples(environment: str) -> Path:
    """Some of an environment's frames, as one picture."""
    return Path("results/samples") / f"{environment}.png"


def probe(environment: str) -> Path:
    """What the features of an environment's frames tell of its state."""
    return Path("results/probe") / f"{environment}.csv"


def models(environment: str, method: str) -> Path:
    """Trained models of one cell."""
    return Path("models") / environment / method


def curve(environment: str, method: str) -> Path:
    """Training curves of one cell."""
    return Path("curves") / environment / f"{method}.csv"


def episodes(environment: str, method: str) -> Path:
    """Evaluation of one cell, a row an episode."""
    return Path("results") / environment / f"{method}.csv"


def scenes(environment: str, method: str) -> Path:
    """Start, goal and end of some episodes of one cell, (episodes, 3, ...); see pipeline.cells.evaluation."""
    return Path("results/scenes") / environment / f"{method}.npy"


def study(name: str) -> Path:
    """Evaluation of one study, a row an episode and sampling."""
    return Path("results/studies") / f"{name}.csv"


def film(environment: str, method: str) -> Path:
    """A folder with the film of one cell, `rollout.webm`, and the filmed episode's row, `rollout.json`."""
    return Path("films") / environment / method
