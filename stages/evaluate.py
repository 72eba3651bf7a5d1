"""Evaluate every seed of one (environment, method) cell."""

from pipeline import params
from pipeline.evaluation import evaluate_cell
from pipeline.stage import run


def main(environment: str, method: str) -> None:
    evaluate_cell(params.load(), environment, method)


if __name__ == "__main__":
    run(main, "environment", "method")
