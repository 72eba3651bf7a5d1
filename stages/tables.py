"""Tables, comparison, metrics and figures from evaluation rows."""

from pathlib import Path

from pipeline import paths
from pipeline.params import load
from pipeline.report.gather import write_tables


def main() -> None:
    write_tables(load(), Path(), paths.REPORTS)
