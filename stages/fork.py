"""Draw actions of every method from the fork, a toy with a known answer."""

from beso.files import write_text
from pipeline import params, paths
from pipeline.fork import measure
from pipeline.stage import run


def main() -> None:
    write_text(paths.FORK, measure(params.load()).to_csv(index=False, float_format="%.6g"))


if __name__ == "__main__":
    run(main)
