"""Tables, comparison, metrics and figures from evaluation rows."""

from beso.files import write_json, write_text
from pipeline import paths
from pipeline.params import load
from pipeline.report import figures, hyperparameters, metrics, tables
from pipeline.report.gather import gather
from pipeline.stage import run


def main() -> None:
    params = load()
    values = gather(params) | {"hyperparameters": hyperparameters.tables(params)}
    values["captions"] = figures.draw_all(params, values, paths.REPORTS / "figures")
    write_text(paths.REPORTS / "tables.tex", tables.render("tables.tex.j2", values))
    write_text(paths.REPORTS / "comparison.csv", values["comparison"].to_csv(index=False, float_format="%.6g"))
    write_json(paths.REPORTS / "metrics.json", metrics.metrics(values))


if __name__ == "__main__":
    run(main)
