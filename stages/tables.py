"""Tables, comparison, metrics and figures from evaluation rows."""

from pathlib import Path

from pipeline import paths
from pipeline.params import load
from pipeline.report.write import write_tables
from pipeline.stage import run


def main() -> None:
    write_tables(load(), Path(), paths.REPORTS)


if __name__ == "__main__":
    run(main)
