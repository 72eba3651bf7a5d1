"""Play with pictures as a LeRobot dataset, and back: version 3.0 of the layout of github.com/huggingface/lerobot.

    meta/info.json                            columns with their types, shapes and names; counts; where files lie
    meta/stats.json                           minimum, maximum, mean, deviation and quantiles of each column
    meta/tasks.parquet                        the numbered texts of tasks
    meta/episodes/chunk-000/file-000.parquet  a row an episode: its length, tasks, data file, first and last frame
    meta/play.json                            meta.json of the raw play, for the way back
    data/chunk-000/file-000.parquet           a row a frame; an episode lies in one file, a file has about 100 MB

Frames are PNG pictures in the data files, so that no pixel changes; videos are smaller, but change pixels. A frame's
`task` is what its segment completes. The package pyarrow is imported when a dataset is written or read.
"""

import importlib
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from beso.checks import numbers
from beso.config import shown
from beso.envs.calvin.demonstrations.official import LARGEST, LARGEST_FRAME
from beso.envs.calvin.demonstrations.raw import BATCH, COLUMNS, RawPlay, writing
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.play_table import CONTROL_HZ
from beso.envs.published import within
from beso.errors import UserError
from beso.files import read_json, replacing, write_json

INFO, STATS, TASKS, PLAY = "meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/play.json"
FILE: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA, EPISODES = f"data/{FILE}", f"meta/episodes/{FILE}"
FILES_A_CHUNK, LARGEST_FILE = 1000, 100  # MB
IMAGE: Final = "observation.images.static"
KEYS: Final = {  # columns of raw play, by LeRobot's names
    "observation.state": "robot_obs",
    "observation.environment_state": "scene_obs",
    "action": "rel_actions",
    "absolute_action": "actions",
    "completed_tasks": "tasks",
    "segment_start": "segment_starts",
}
INDICES: Final = {  # that every LeRobot dataset has
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
QUANTILES: Final = (1, 10, 50, 90, 99)  # per cent
SAMPLED_FRAMES: Final = 100  # that the statistics of pictures are of
NO_TASK: Final = "play"


def export(play: RawPlay, folder: Path) -> None:
    """Write play as a LeRobot dataset, atomically.

    Raises:
        UserError: the packages are not installed.
    """
    texts = segment_texts(play)
    numbered = list(dict.fromkeys(texts))
    with replacing(folder) as temporary:
        writer = _Writer(temporary, _schema())
        for i, rows in enumerate(play.episodes()):
            said = texts[rows]
            writer.start(i, rows, sorted(set(said)))
            for start in range(rows.start, rows.stop, BATCH):
                batch = slice(start, min(start + BATCH, rows.stop))
                index = np.arange(batch.start, batch.stop)
                indices = {
                    "timestamp": (index - rows.start) / CONTROL_HZ,
                    "frame_index": index - rows.start,
                    "episode_index": np.full(len(index), i),
                    "index": index,
                    "task_index": [numbered.index(text) for text in texts[batch]],
                }
                writer.append(play, batch, indices)
        writer.close()
        pandas = importlib.import_module("pandas")
        table = pandas.DataFrame({"task_index": range(len(numbered))}, index=pandas.Index(numbered, name="task"))
        table.to_parquet(temporary / TASKS)
        write_json(temporary / STATS, _statistics(play))
        write_json(temporary / PLAY, play.meta)
        write_json(temporary / INFO, _info(play, len(numbered)))


def segment_texts(play: RawPlay) -> np.ndarray:
    """What the segment of each frame completes, in words, (steps,)."""
    starts = play.segment_starts.astype(bool)
    starts[[rows.start for rows in play.episodes()]] = True
    first = np.flatnonzero(starts)
    texts = []
    for begin, end in zip(first, [*first[1:], len(starts)], strict=True):
        done = np.flatnonzero(play.tasks[begin:end].any(axis=0))
        texts += [" and ".join(tasks.NAMES[task].replace("_", " ") for task in done) or NO_TASK] * int(end - begin)
    return np.array(texts, dtype=object)


@dataclass
class _Writer:
    """Data files and the list of episodes."""

    folder: Path
    schema: Any
    episodes: list[dict[str, Any]] = field(default_factory=list)
    number: int = -1  # of the data file
    size: float = math.inf  # of the data file, bytes
    file: Any = None

    def start(self, episode: int, rows: slice, texts: list[str]) -> None:
        if self.size >= LARGEST_FILE << 20:
            self.number, self.size = self.number + 1, 0
            self.close_file()
            path = self.folder / DATA.format(**_place(self.number))
            path.parent.mkdir(parents=True, exist_ok=True)
            self.file = _parquet().ParquetWriter(path, self.schema, write_page_checksum=True)
        data = {f"data/{key}": value for key, value in _place(self.number).items()}
        own = {f"meta/episodes/{key}": value for key, value in _place(0).items()}
        span = {"length": rows.stop - rows.start, "dataset_from_index": rows.start, "dataset_to_index": rows.stop}
        self.episodes.append({"episode_index": episode, "tasks": texts, **span, **data, **own})

    def append(self, play: RawPlay, rows: slice, indices: Mapping[str, Any]) -> None:
        arrow = importlib.import_module("pyarrow")
        pictures = [_png(frame) for frame in play.frames[rows]]
        paths = [f"frame-{number:06d}.png" for number in indices["frame_index"]]
        columns = {IMAGE: arrow.StructArray.from_arrays([arrow.array(pictures), arrow.array(paths)], ["bytes", "path"])}
        for key, name in KEYS.items():
            values, kind = getattr(play, name)[rows], self.schema.field(key).type
            columns[key] = arrow.array(values if values.ndim == 1 else list(values), kind)
        columns |= {key: arrow.array(np.asarray(values).astype(INDICES[key])) for key, values in indices.items()}
        table = arrow.table(columns, schema=self.schema)
        self.file.write_table(table)
        self.size += table.nbytes

    def close(self) -> None:
        self.close_file()
        path = self.folder / EPISODES.format(**_place(0))
        path.parent.mkdir(parents=True)
        _parquet().write_table(importlib.import_module("pyarrow").Table.from_pylist(self.episodes), path)

    def close_file(self) -> None:
        if self.file is not None:
            self.file.close()


def _place(number: int) -> dict[str, int]:
    return {"chunk_index": number // FILES_A_CHUNK, "file_index": number % FILES_A_CHUNK}


def _schema() -> Any:
    arrow = _arrow()
    fields = [(IMAGE, arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())]))]
    for key, name in KEYS.items():
        row, dtype = COLUMNS[name]
        number = arrow.from_numpy_dtype(np.dtype(dtype))
        fields.append((key, arrow.list_(number, row[0]) if row else number))
    return arrow.schema([*fields, *((key, arrow.from_numpy_dtype(np.dtype(kind))) for key, kind in INDICES.items())])


def _info(play: RawPlay, texts: int) -> dict[str, Any]:
    features: dict[str, Any] = {
        IMAGE: {"dtype": "image", "shape": play.frames.shape[1:], "names": ["height", "width", "channels"]}
    }
    for key, name in KEYS.items():
        row, dtype = COLUMNS[name]
        names = list(tasks.NAMES) if name == "tasks" else None
        features[key] = {"dtype": dtype, "shape": row or (1,), "names": names}
    features |= {key: {"dtype": dtype, "shape": (1,), "names": None} for key, dtype in INDICES.items()}
    return {
        "codebase_version": "v3.0",
        "robot_type": "panda",
        "fps": CONTROL_HZ,
        "features": features,
        "total_episodes": len(play),
        "total_frames": len(play.frames),
        "total_tasks": texts,
        "chunks_size": FILES_A_CHUNK,
        "data_files_size_in_mb": LARGEST_FILE,
        "video_files_size_in_mb": 2 * LARGEST_FILE,
        "data_path": DATA,
        "video_path": None,
        "splits": {"train": f"0:{len(play)}"},
    }


def _statistics(play: RawPlay) -> dict[str, dict[str, Any]]:
    sampled = np.unique(np.linspace(0, len(play.frames) - 1, SAMPLED_FRAMES).astype(int))
    pixels = _described(play.frames[sampled].reshape(-1, 3) / 255, (3, 1, 1)) | {"count": [len(sampled)]}
    states = {key: getattr(play, name).reshape(len(play.frames), -1) for key, name in KEYS.items()}
    return {IMAGE: pixels} | {key: _described(values, (-1,)) for key, values in states.items()}


def _described(values: np.ndarray, shape: tuple[int, ...]) -> dict[str, Any]:
    found = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0, dtype=np.float64),
        "std": values.std(axis=0, dtype=np.float64),
        **{f"q{q:02d}": np.quantile(values, q / 100, axis=0) for q in QUANTILES},
    }
    return {name: value.reshape(shape).tolist() for name, value in found.items()} | {"count": [len(values)]}


def _png(frame: np.ndarray) -> bytes:
    return cv2.imencode(".png", cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))[1].tobytes()


def is_dataset(folder: Path) -> bool:
    """Whether a folder holds a LeRobot dataset."""
    return (folder / INFO).is_file()


def convert(folder: Path, target: Path, size: int | None) -> None:
    """Bring a dataset that `export` wrote into the form of `raw`; at their own size, frames are the same.

    Args:
        folder: the one with `meta` and `data`.
        target: the folder to write.
        size: height and width of the frames written, pixels; None keeps those of the files.

    Raises:
        UserError: a file is missing or damaged, the dataset has other columns, a number is not finite or out of range,
            or the packages are not installed.
    """
    info, said = read_json(folder / INFO), read_json(folder / PLAY)
    features = info.get("features")
    missing = [key for key in (IMAGE, *KEYS) if not isinstance(features, dict) or key not in features]
    if missing:
        raise UserError(f"{folder / INFO}: no column of this name: {missing[0]}; `beso export` writes it")
    meta = {key: value for key, value in said.items() if key not in ("sha256", "counts", "versions")}
    with writing(target, meta) as writer:
        episode, shape, count = None, None, 0
        for path, number, columns in _rows(folder, size):
            if episode not in (None, number):
                writer.end_episode()
            episode, shape = number, shape or columns["frames"].shape[1:]
            if columns["frames"].shape[1:] != shape:
                raise UserError(f"{path}: a frame of shape {columns['frames'].shape[1:]}, those before have {shape}")
            writer.append(columns)
            count += len(columns["frames"])
        if count != info.get("total_frames"):
            raise UserError(f"{folder} has {count} frames; {INFO} says {shown(info.get('total_frames'))}")
        if episode is not None:
            writer.end_episode()


def _rows(folder: Path, size: int | None) -> Iterator[tuple[Path, int, dict[str, np.ndarray]]]:
    """Rows of one episode each, at most BATCH, with its number and the file's path."""
    count = 0
    for path in sorted(filter(Path.is_file, (folder / "data").glob("*/*.parquet"))):
        for table in _batches(path):
            index, episodes = (
                numbers(f"{path}: {key}", table.column(key).to_pylist(), (None,)) for key in ("index", "episode_index")
            )
            if not np.array_equal(index, np.arange(count, count + len(index))):
                raise UserError(f"{path}: index does not go on from {count}: a file or rows are missing or moved")
            count += len(index)
            cuts = [0, *(np.flatnonzero(np.diff(episodes)) + 1), len(episodes)]
            for start, end in itertools.pairwise(cuts):
                yield path, int(episodes[start]), _columns(table.slice(start, end - start), path, size)


def _batches(path: Path) -> Iterator[Any]:
    columns = [IMAGE, *KEYS, "index", "episode_index"]
    schema = _arrow().schema([_schema().field(name) for name in columns])
    try:
        file = _parquet().ParquetFile(path, page_checksum_verification=True)
        yield from (batch.select(columns).cast(schema) for batch in file.iter_batches(BATCH, columns=columns))
    except Exception as error:  # pyarrow raises many kinds, some with many lines
        raise UserError(
            f"{path} is damaged, or has not the columns of `beso export` ({type(error).__name__})"
        ) from None


def _columns(table: Any, path: Path, size: int | None) -> dict[str, np.ndarray]:
    found = {}
    for key, name in KEYS.items():
        row, dtype = COLUMNS[name]
        what = f"{path}: {key}"
        values = numbers(what, table.column(key).to_pylist(), (None, *row))
        if dtype == "uint8" and not np.isin(values, (0, 1)).all():
            raise UserError(f"{what} holds {values[~np.isin(values, (0, 1))][0]}, expected 0 and 1")
        within(what, values, LARGEST.get(name, 1))
        found[name] = values.astype(dtype)
    frames = [_frame((picture or {}).get("bytes"), path, size) for picture in table.column(IMAGE).to_pylist()]
    if len({frame.shape for frame in frames}) > 1:
        raise UserError(f"{path}: {IMAGE} holds pictures of more than one size")
    return {"frames": np.stack(frames), **found}


def _frame(png: bytes | None, path: Path, size: int | None) -> np.ndarray:
    width, height = (int.from_bytes((png or b"")[at : at + 4], "big") for at in (16, 20))  # as PNG has them
    fits = 0 < 3 * width * height <= LARGEST_FRAME and width == height
    frame = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png and fits else None
    if frame is None:
        raise UserError(f"{path}: {IMAGE} holds something else than square pictures")
    if size is not None and len(frame) != size:
        frame = cv2.resize(frame, (size, size), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)


def _arrow() -> Any:
    try:
        return importlib.import_module("pyarrow")
    except ImportError as error:
        raise UserError(
            f"a LeRobot dataset needs the package pyarrow: install this project with its extra [lerobot] ({error})"
        ) from None


def _parquet() -> Any:
    return importlib.import_module("pyarrow.parquet")
