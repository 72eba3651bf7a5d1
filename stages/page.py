"""The report page, and the latency table, from everything that other stages wrote."""

import pandas as pd

from beso.files import write_text
from pipeline import page, params, paths, tables
from pipeline.report import gather
from pipeline.stage import run


def main() -> None:
    configuration = params.load()
    values = gather(configuration)
    latency = pd.read_csv(paths.LATENCY)
    write_text(paths.REPORTS / "latency.tex", tables.render("latency.tex.j2", {**values, "latency": latency}))
    write_text(paths.REPORTS / "report.html", page.render(configuration, values, latency))


if __name__ == "__main__":
    run(main)
