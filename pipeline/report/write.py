"""What the stage `tables` writes, of any run."""

from pathlib import Path

from beso.files import write_json, write_text
from pipeline.params import Params
from pipeline.report import figures, hyperparameters, metrics, tables
from pipeline.report.gather import gather


def write_tables(params: Params, root: Path, folder: Path) -> None:
    """Write LaTeX tables, comparison, metrics and figures into a folder.

    Args:
        params, root: see pipeline.report.gather.gather.
    """
    values = gather(params, root) | {"hyperparameters": hyperparameters.tables(params)}
    values["captions"] = figures.draw_all(params, values, folder / "figures")
    write_text(folder / "tables.tex", tables.render("tables.tex.j2", values))
    write_text(folder / "comparison.csv", values["comparison"].to_csv(index=False, float_format="%.6g"))
    write_json(folder / "metrics.json", metrics.metrics(values))
