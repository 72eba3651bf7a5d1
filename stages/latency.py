"""Milliseconds a policy call of every method at the paper's size."""

from beso.files import write_text
from pipeline import paths
from pipeline.cells.latency import measure
from pipeline.params import load
from pipeline.stage import run


def main() -> None:
    write_text(paths.LATENCY, measure(load()).to_csv(index=False))


if __name__ == "__main__":
    run(main)
