"""Train every seed of one (environment, method) cell."""

from pipeline.cells.training import train_cell
from pipeline.params import load
from pipeline.stage import run


def main(environment: str, method: str) -> None:
    train_cell(load(), environment, method)


if __name__ == "__main__":
    run(main, "environment", "method")
