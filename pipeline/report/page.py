"""reports/report.html: one self-contained page that opens offline, in the order and with the names of the paper."""

import base64
import importlib.metadata
import platform
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import pandas as pd

from beso import envs
from beso.files import read_json
from pipeline import paths, profile
from pipeline.params import PATH, Params
from pipeline.report import tables
from pipeline.report.comparison import VERDICTS, paper_numbers
from pipeline.report.figures import CAPTIONS

# What bytes of results depend on.
PACKAGES = ["torch", "numpy", "pybullet", "mujoco", "gymnasium", "gymnasium-robotics", "scipy", "scikit-learn"]
PACKAGES += ["threadpoolctl", "safetensors", "pandas", "matplotlib", "opencv-python-headless"]
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
    verdicts, numbers = values["comparison"]["verdict"].value_counts(), paper_numbers()
    figures = [_figure(**of) for of in read_json(paths.REPORTS / "figures" / CAPTIONS)["figures"]]
    beginnings = {place.name: place.figures.split() for place in values["places"]}
    others = {name: profile.load(name) for name in profile.names() if name != params.profile}

    def makers(starts: Iterable[str]) -> list[str]:
        """Other profiles that run an environment, a cell or a study whose name starts in one of these ways."""
        names = {name: [*other.envs, *other.cells, *other.studies] for name, other in others.items()}
        return [name for name, has in names.items() if any(key.startswith(tuple(starts)) for key in has)]

    shown = values | {
        "isna": pd.isna,
        "makers": makers,
        "verdicts": {verdict: int(verdicts.get(verdict, 0)) for verdict in VERDICTS},
        "count": len(numbers),
        "seconds": numbers[numbers["metric"] == SECONDS].set_index("method")["mean"].to_dict(),
        "figures": arrange(figures, beginnings | BEYOND),
        "table_of": {table.name: table for table in values["own_tables"]},
        "bare_tables": [table for table in values["own_tables"] if table.name not in {f.name for f in figures}],
        "films": _films(params, PAGE_BYTES - sum(len(figure.data or "") for figure in figures)),
        "photos": PHOTOS,
        "latency": latency,
        "variant_sizes": variant_sizes(params, latency),
        "params_text": PATH.read_text(encoding="utf-8"),
        "versions": versions(),
    }
    return tables.render("report.html.j2", shown)


def variant_sizes(params: Params, latency: pd.DataFrame) -> list[str]:
    """In words, the parameters of each variant whose network has not as many as that of the method that it changes."""
    counts, found = latency.groupby(["environment", "method"])["parameters"].first().to_dict(), []
    for cell in params.cells.values():
        base, variant = counts.get((cell.env, cell.of)), counts.get((cell.env, cell.method))
        if base and variant and base != variant:
            numbers = f"{params.labels[cell.of]} {base:,}, {params.labels[cell.method]} {variant:,}"
            found.append(f"{envs.report(cell.env).LABEL}: {numbers}")
    return found


def arrange(figures: list[Picture], beginnings: Mapping[str, Iterable[str]]) -> dict[str, list[Picture]]:
    """Figures by the part of the page that shows them: each in the first whose beginnings its name has, or in REST."""
    parts: dict[str, list[Picture]] = {part: [] for part in [*beginnings, REST]}
    for figure in figures:
        fitting = (part for part, starts in beginnings.items() if figure.name.startswith(tuple(starts)))
        parts[next(fitting, REST)].append(figure)
    return parts


def _figure(name: str, caption: str) -> Picture:
    path = paths.REPORTS / "figures" / f"{name}.png"
    image, kind = path.read_bytes(), "image/png"
    width, height = struct.unpack(">II", image[16:24])  # a PNG's first chunk begins with its size
    if name.startswith(PHOTOS):
        _, encoded = cv2.imencode(".jpg", cv2.imread(str(path)), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        image, kind = encoded.tobytes(), "image/jpeg"
    return Picture(name, caption, _data_url(image, kind), round(width * SCALE), round(height * SCALE))


def _films(params: Params, room: float) -> list[Picture]:
    """The films: of each environment its play, then its methods.

    Where not all fit into so many bytes, those of every environment's first methods are left out.
    """
    chosen: list[tuple[int, str, str, Path]] = []  # its turn in taking room, environment, what is filmed, folder
    for env in params.envs:
        filmed = [cell for cell in params.cells_in(env) if cell.evaluate.film]
        chosen.append((0, env, "Play", paths.film_of_play(env)))
        chosen += [(len(filmed) - i, env, params.labels[of.method], of.film_folder) for i, of in enumerate(filmed)]
    films = {}
    for _, env, what, folder in sorted(chosen, key=lambda film: film[0]):
        path = folder / "rollout.webm"
        row, metric = read_json(path.with_suffix(".json")), envs.report(env).METRICS[-1]
        caption, data = f"{what} in {envs.report(env).LABEL}", None
        if "no_film" in row:
            caption += f": no film. {row['no_film']}"
        else:
            told = row.get("shows") or (
                f"seed {row['seed']}, episode {row['episode']}, {metric.label.lower()} {row[metric.name]:g} after"
                f" {row['length']} actions"
            )
            caption += f": {told}"
            data = _data_url(path.read_bytes(), "video/webm")
            if len(data) > room:
                caption, data = f"{caption}. The page has no room for it: {path}", None
        room -= len(data or "")
        films[folder] = Picture(folder.as_posix(), caption, data)
    return [films[folder] for *_, folder in chosen]


def _data_url(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    versions = {name: importlib.metadata.version(name) for name in (*PACKAGES, "dvc")}
    return {"Python": platform.python_version(), "System": f"{platform.system()} {platform.machine()}", **versions}
