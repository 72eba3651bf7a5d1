"""Film the first episode of one cell."""

from pipeline.cells.film import film_cell
from pipeline.params import load
from pipeline.stage import run


def main(environment: str, method: str) -> None:
    film_cell(load(), environment, method)


if __name__ == "__main__":
    run(main, "environment", "method")
