"""The encoder of one environment's frames, their features, and what these tell."""

from pipeline.cells.features import make_features
from pipeline.params import load
from pipeline.stage import run


def main(environment: str) -> None:
    make_features(load(), environment)


if __name__ == "__main__":
    run(main, "environment")
