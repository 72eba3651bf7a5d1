"""reports/report.html: one self-contained page that opens offline, in the order and with the names of the paper."""

import base64
import importlib.metadata
import platform
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jinja2
import pandas as pd

from beso import envs
from beso.files import read_json
from pipeline import paths
from pipeline.params import PATH, Cell, Params
from pipeline.report import hyperparameters
from pipeline.report.comparison import VERDICTS, paper_numbers
from pipeline.report.figures import CAPTIONS
from pipeline.report.names import Names
from pipeline.report.sheets import other_profiles
from pipeline.report.tables import TEMPLATES

PACKAGES = (
    "torch",
    "numpy",
    "pybullet",
    "mujoco",
    "gymnasium",
    "gymnasium-robotics",
    "scipy",
    "scikit-learn",
    "threadpoolctl",
    "safetensors",
    "pandas",
    "matplotlib",
    "opencv-python-headless",
    "dvc",
)
SECONDS = "seconds"  # the metric of the paper's times
SCALE = 0.6  # the page's pixels for one of a figure, so that figures are sharp on dense screens
PAGE_BYTES = 14e6  # of figures and films, in base64; with the text, the page stays under 15 MB
PHOTOS = ("goals_", "samples_")  # how the names of figures begin that are mostly frames
JPEG_QUALITY = 85
# Parts of the page beyond the paper's, and how the names of their figures begin. What no part has goes to REST.
BEYOND = {
    "overview": ["overview"],
    "studies": ["study_"],
    "training": ["training_"],
    "fork": ["fork"],
    "frames": ["samples_", "probe_"],
}
REST = "environments"


class Picture(NamedTuple):
    """A figure or film.

    Attributes:
        data: a data URL; None where there is none, and then the caption says why.
        width, height: of a figure, in the page's pixels.
    """

    name: str
    caption: str
    data: str | None
    width: int = 0
    height: int = 0


def render(params: Params, values: dict[str, Any], latency: pd.DataFrame) -> str:
    """The page's HTML.

    Args:
        values: from pipeline.report.gather.gather.
        latency: from stages.latency.measure.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    folder, others = paths.REPORTS / "figures", other_profiles(params)
    verdicts, numbers = values["comparison"]["verdict"].value_counts(), paper_numbers()
    shares = hyperparameters.shares_of_training(params)
    drawn = read_json(folder / CAPTIONS)["figures"]
    figures = [_figure(of["name"], of["caption"], folder / f"{of['name']}.png") for of in drawn]
    beginnings = {place.name: place.figures.split() for place in values["places"]}

    def makers(starts: Iterable[str]) -> list[str]:
        """Other profiles that run a cell or study whose name starts in one of these ways."""
        return [name for name, has in others.items() if any(key.startswith(tuple(starts)) for key in has)]

    return environment.get_template("report.html.j2").render(
        **values,
        isna=pd.isna,
        makers=makers,
        verdicts={verdict: int(verdicts.get(verdict, 0)) for verdict in VERDICTS},
        count=len(numbers),
        seconds=numbers[numbers["metric"] == SECONDS].set_index("method")["mean"].to_dict(),
        generated={name: play["source"] == "scripted" for name, play in values["play"].items()},
        figures=arrange(figures, beginnings | BEYOND),
        study_of={f"study_{table.name}": table for table in values["studies"]},
        table_of={table.name: table for table in values["own_tables"]},
        bare_tables=[table for table in values["own_tables"] if table.name not in {f.name for f in figures}],
        films=_films(params, values["names"], PAGE_BYTES - sum(len(figure.data or "") for figure in figures)),
        photos=PHOTOS,
        variant_sizes=variant_sizes(params, values["names"], latency),
        hyperparameters=hyperparameters.by_method(params),
        shares=shares,
        trained=list(dict.fromkeys(method for share in shares for method in share["shares"])),
        latency=latency,
        params_text=PATH.read_text(encoding="utf-8"),
        versions=versions(),
    )


def arrange(figures: list[Picture], beginnings: Mapping[str, Iterable[str]]) -> dict[str, list[Picture]]:
    """Figures by the part of the page that shows them: each in the first whose beginnings its name has, or in REST."""
    parts: dict[str, list[Picture]] = {part: [] for part in [*beginnings, REST]}
    for figure in figures:
        fitting = (part for part, starts in beginnings.items() if figure.name.startswith(tuple(starts)))
        parts[next(fitting, REST)].append(figure)
    return parts


def variant_sizes(params: Params, names: Names, latency: pd.DataFrame) -> list[str]:
    """In words, the parameters of each variant whose network has not as many as that of the method that it changes.

    Args:
        latency: from stages.latency.measure, which counts them at the paper's size.
    """
    counts = {(row.environment, row.method): row.parameters for row in latency.itertuples()}
    found = []
    for cell in params.cells.values():
        base, variant = counts.get((cell.env, cell.of)), counts.get((cell.env, cell.method))
        if base and variant and base != variant:
            labels = names.methods
            found.append(
                f"{names.environments[cell.env]}: {labels[cell.of]} {base:,}, {labels[cell.method]} {variant:,}"
            )
    return found


def _figure(name: str, caption: str, path: Path) -> Picture:
    image = path.read_bytes()
    width, height = struct.unpack(">II", image[16:24])  # a PNG's first chunk begins with its size
    if name.startswith(PHOTOS):
        _, encoded = cv2.imencode(".jpg", cv2.imread(str(path)), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        data = _data_url(encoded.tobytes(), "image/jpeg")
    else:
        data = _data_url(image, "image/png")
    return Picture(name, caption, data, round(width * SCALE), round(height * SCALE))


def _films(params: Params, names: Names, room: float) -> list[Picture]:
    """The films. Where not all fit into so many bytes, those of every environment's first methods are left out."""
    films: dict[str, Picture] = {}
    chosen = [cell for cell in params.cells.values() if cell.evaluate.film]
    for cell in sorted(chosen, key=lambda cell: _behind(chosen, cell)):
        key, path = cell.name, cell.film_folder / "rollout.webm"
        row, metric = read_json(path.with_suffix(".json")), envs.report(cell.env).METRICS[-1]
        title = f"{names.methods[cell.method]} in {names.environments[cell.env]}"
        if "no_film" in row:
            films[key] = Picture(key, f"{title}: no film. {row['no_film']}", None)
            continue
        caption = (
            f"{title}: seed {row['seed']}, episode {row['episode']}, {metric.label.lower()} {row[metric.name]:g} after"
            f" {row['length']} actions"
        )
        data = _data_url(path.read_bytes(), "video/webm")
        if len(data) > room:
            films[key] = Picture(key, f"{caption}. The page has no room for it: {path}", None)
        else:
            room -= len(data)
            films[key] = Picture(key, caption, data)
    return [films[cell.name] for cell in chosen]


def _behind(chosen: list[Cell], film: Cell) -> int:
    """How many films of the same environment come after this one."""
    same = [other.method for other in chosen if other.env == film.env]
    return len(same) - 1 - same.index(film.method)


def _data_url(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"Python": platform.python_version(), "System": f"{platform.system()} {platform.machine()}", **versions}
