"""Raw play data of one environment."""

from pipeline.cells.collect import collect
from pipeline.params import load
from pipeline.stage import run


def main(environment: str) -> None:
    collect(load(), environment)


if __name__ == "__main__":
    run(main, "environment")
