"""reports/report.html: one self-contained page that opens offline."""

import base64
import importlib.metadata
import platform
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from beso import envs
from beso.files import read_json
from pipeline import paths
from pipeline.params import PATH, Params
from pipeline.report.figures import CAPTIONS
from pipeline.report.names import Names
from pipeline.report.tables import TEMPLATES

PACKAGES = (
    "torch",
    "numpy",
    "pybullet",
    "gymnasium",
    "safetensors",
    "pandas",
    "matplotlib",
    "opencv-python-headless",
    "dvc",
)


def render(params: Params, values: dict[str, Any], latency: pd.DataFrame) -> str:
    """The page's HTML.

    Args:
        values: from pipeline.report.gather.gather.
        latency: from pipeline.cells.latency.measure.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    names: Names = values["names"]
    folder = paths.REPORTS / "figures"
    figures = [
        {"data": _data_url(folder / f"{figure['name']}.png", "image/png"), "caption": figure["caption"]}
        for figure in read_json(folder / CAPTIONS)["figures"]
    ]
    return environment.get_template("report.html.j2").render(
        **values,
        figures=figures,
        films=_films(params, names),
        latency=latency,
        params_text=PATH.read_text(encoding="utf-8"),
        versions=versions(),
    )


def _films(params: Params, names: Names) -> list[dict[str, str]]:
    films = []
    for cell in params.films.values():
        path = paths.film(cell.env, cell.method) / "rollout.webm"
        row, metric = read_json(path.with_suffix(".json")), envs.report(cell.env).METRICS[-1]
        title = f"{names.methods[cell.method]} in {names.environments[cell.env]}"
        if "no_film" in row:
            films.append({"data": "", "caption": f"{title}: no film. {row['no_film']}"})
            continue
        caption = (
            f"{title}: seed {row['seed']}, episode {row['episode']}, {metric.label.lower()} {row[metric.name]:g} after"
            f" {row['length']} actions"
        )
        films.append({"data": _data_url(path, "video/webm"), "caption": caption})
    return films


def _data_url(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"Python": platform.python_version(), "System": f"{platform.system()} {platform.machine()}", **versions}
