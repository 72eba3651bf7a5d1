"""Make the episodes that one environment's methods are evaluated on."""

from pipeline.cells.trials import make_trials
from pipeline.params import load
from pipeline.stage import run


def main(environment: str) -> None:
    make_trials(load(), environment)


if __name__ == "__main__":
    run(main, "environment")
