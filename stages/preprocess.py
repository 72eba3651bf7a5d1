"""Packed frames of one environment that sees images."""

from pipeline.cells.preprocess import preprocess
from pipeline.params import load
from pipeline.stage import run


def main(environment: str) -> None:
    preprocess(load(), environment)


if __name__ == "__main__":
    run(main, "environment")
