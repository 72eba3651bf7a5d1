"""reports/report.html: one self-contained page that opens offline."""

import base64
import importlib.metadata
import platform
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from pipeline import names, paths
from pipeline.comparison import read_episodes
from pipeline.params import PATH, Params
from pipeline.tables import TEMPLATES

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
        values: from pipeline.report.gather.
        latency: from pipeline.latency.measure.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    figures = []
    for name in params.grid.envs:
        title = names.ENVIRONMENTS[name]
        figures += [
            _figure(
                f"scores_{name}", f"{title}: reward and result beside the paper's; lines are one standard deviation."
            ),
            _figure(
                f"training_{name}", f"{title}: squared error of actions generated on held-out windows, a line a seed."
            ),
        ]
    figures.append(
        _figure("fork", "The fork, a toy: one state with two right actions, and the actions each method draws from it.")
    )
    return environment.get_template("report.html.j2").render(
        **values,
        figures=figures,
        films=_films(params),
        latency=latency,
        params_text=PATH.read_text(encoding="utf-8"),
        versions=versions(),
    )


def _figure(name: str, caption: str) -> dict[str, str]:
    return {"data": _data_url(paths.REPORTS / "figures" / f"{name}.png", "image/png"), "caption": caption}


def _films(params: Params) -> list[dict[str, str]]:
    films = []
    for environment in params.grid.envs:
        for method in params.grid.methods:
            path = paths.videos(environment, method) / "rollout.webm"
            if path.exists():
                row = read_episodes(environment, method).iloc[0]
                caption = (
                    f"{names.METHODS[method]} in {names.ENVIRONMENTS[environment]}: seed {row['seed']}, episode"
                    f" {row['episode']}, result {row['result']:g} after {row['length']} actions"
                )
                films.append({"data": _data_url(path, "video/webm"), "caption": caption})
    return films


def _data_url(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"Python": platform.python_version(), "System": f"{platform.system()} {platform.machine()}", **versions}
