"""Tables, comparison and figures from evaluation rows."""

from beso.files import write_text
from pipeline import figures, hyperparameters, params, paths, report, tables
from pipeline.stage import run


def main() -> None:
    configuration = params.load()
    values = report.gather(configuration)
    tables_values = {**values, "hyperparameters": hyperparameters.tables(configuration)}
    write_text(paths.REPORTS / "tables.tex", tables.render("tables.tex.j2", tables_values))
    write_text(paths.REPORTS / "comparison.csv", values["comparison"].to_csv(index=False, float_format="%.6g"))
    figures.draw_all(configuration, values["comparison"], paths.REPORTS / "figures")


if __name__ == "__main__":
    run(main)
