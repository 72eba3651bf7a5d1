"""Draw actions of every method from the fork, a toy with a known answer."""

from beso.files import write_text
from pipeline import paths
from pipeline.cells.fork import measure
from pipeline.params import load
from pipeline.stage import run


def main() -> None:
    write_text(paths.FORK, measure(load()).to_csv(index=False, float_format="%.6g"))


if __name__ == "__main__":
    run(main)
