"""The page's films: what is filmed, and its captions."""

import numpy as np

from pipeline import paths, profile
from pipeline.film import write_film, write_video
from pipeline.report import page


def film(row, path):
    write_video(path, [np.full((48, 64, 3), 40 * i, dtype=np.uint8) for i in range(3)], 20)
    return row


def test_play_is_each_environments_first_film(tmp_path, monkeypatch):
    params = profile.load("smoke")
    monkeypatch.chdir(tmp_path)
    folders = {env: [paths.film_of_play(env), *(c.film_folder for c in params.cells_in(env))] for env in params.envs}
    for env, (play, *cells) in folders.items():
        write_film(play, film, ({"shows": f"what {env} shows"},))
        for folder in cells:
            write_film(folder, film, ({},), "nobody asked")
    shown = page._films(params, 1e6)
    assert all(f.data.startswith("data:video/webm") for f in shown if f.name.endswith("/play"))
    starts = [i for i, f in enumerate(shown) if f.name.endswith("/play")]
    assert [shown[i].name for i in starts] == [f"films/{env}/play" for env in params.envs]
    assert starts[0] == 0
    assert all(shown[i].caption.endswith(f": what {env} shows") for i, env in zip(starts, params.envs, strict=True))
    assert all("no film. nobody asked" in f.caption for i, f in enumerate(shown) if i not in starts)
