"""Train every seed of one (environment, method) cell."""

from pipeline import params
from pipeline.stage import run
from pipeline.training import train_cell


def main(environment: str, method: str) -> None:
    train_cell(params.load(), environment, method)


if __name__ == "__main__":
    run(main, "environment", "method")
