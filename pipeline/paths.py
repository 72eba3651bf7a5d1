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


def film_of_play(environment: str) -> Path:
    """A folder with a film of play, `rollout.webm`, and what it shows, `rollout.json`."""
    return Path("films") / environment / "play"


def frames(environment: str) -> Path:
    """Packed frames of an environment that sees images."""
    return Path("data/frames") / environment


def samples(environment: str) -> Path:
    """Some of an environment's frames, as one picture."""
    return Path("results/samples") / f"{environment}.png"


def probe(environment: str) -> Path:
    """What the features of an environment's frames tell of its state."""
    return Path("results/probe") / f"{environment}.csv"
