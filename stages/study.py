"""Evaluate one trained cell with every sampling of a study."""

from pipeline.cells.study import run_study
from pipeline.params import load
from pipeline.stage import run


def main(name: str) -> None:
    run_study(load(), name)


if __name__ == "__main__":
    run(main, "name")
