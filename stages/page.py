"""The report page, and the latency table, from everything that other stages wrote."""

import pandas as pd

from beso.files import write_text
from pipeline import paths
from pipeline.params import load
from pipeline.report import page, tables
from pipeline.report.gather import gather


def main() -> None:
    params = load()
    values, latency = gather(params), pd.read_csv(paths.LATENCY)
    write_text(paths.REPORTS / "latency.tex", tables.render("latency.tex.j2", {**values, "latency": latency}))
    write_text(paths.REPORTS / "report.html", page.render(params, values, latency))
