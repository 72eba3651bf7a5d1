"""Milliseconds a policy call of every method at the paper's size."""

from beso.files import write_text
from pipeline import params, paths
from pipeline.latency import measure
from pipeline.stage import run


def main() -> None:
    write_text(paths.LATENCY, measure(params.load()).to_csv(index=False))


if __name__ == "__main__":
    run(main)
