import base64
import re
import shutil
import subprocess
from collections import Counter
from html.parser import HTMLParser

import cv2
import numpy as np
import pandas as pd
import pytest
from ruamel.yaml import YAML

from beso.errors import CannotDrawError
from pipeline import params, profile
from pipeline.film import write_film, write_video
from pipeline.report import page
from pipeline.report.comparison import places
from pipeline.report.gather import gather
from pipeline.report.tables import main_methods

METHODS = main_methods(profile.load("smoke"))


def test_comparison_has_every_cell_and_follows_from_the_rows(finished):
    table = pd.read_csv(finished.folder / "reports/comparison.csv")
    # The text repeats some numbers of the main table.
    keys = ["environment", "metric", "method", "goals"]
    ours = table[table["ours"].notna() & table["study"].isna()].drop_duplicates(keys)
    assert len(ours) == len(profile.load("smoke").cells) * 2 * 2  # metrics, goal sets
    for row in ours.itertuples():
        rows = pd.read_csv(finished.folder / f"results/{row.environment}/{row.method}.csv")
        rows = rows[rows["goals"] == row.goals]
        by_seed = [part[row.metric].sum() / len(part) for _, part in rows.groupby("seed")]
        assert row.ours == pytest.approx(np.mean(by_seed), abs=1e-6)
        if len(by_seed) > 1:
            assert row.ours_std == pytest.approx(np.std(by_seed, ddof=1), abs=1e-6)
        assert row.ours_low <= row.ours <= row.ours_high
        assert (row.seeds, row.episodes) == (len(by_seed), len(rows))
    assert set(ours["seeds"]) == {1, 2}  # of the kitchen and of block push in this profile
    beside = ours[(ours["goals"] == "training") & ours["method"].isin(METHODS)]
    assert len(beside) == 2 * 2 * len(METHODS)  # of the paper's main table: environments, metrics
    assert beside[["paper", "difference", "difference_low", "difference_high", "verdict"]].notna().all(axis=None)
    assert beside["difference"].between(beside["difference_low"], beside["difference_high"]).all()
    assert ours["data"].eq("scripted demonstrations made here").all()


def test_comparison_has_every_number_of_the_paper_with_a_verdict(finished):
    table = pd.read_csv(finished.folder / "reports/comparison.csv")
    numbers = table[table["place"].notna()]
    assert len(numbers) == 195
    # The main table, the text's; noise, schedules, and of the samplers two with three steps.
    measured = 32 + 5 + 12 + 24 + 2 * 2 * 2
    assert numbers["verdict"].value_counts()[["not run", "timed apart"]].tolist() == [195 - measured - 2, 2]
    assert (numbers["verdict"] == "not run").sum() == numbers.loc[numbers["environment"].notna(), "ours"].isna().sum()


def test_studies_stand_beside_the_papers_numbers(finished):
    table = pd.read_csv(finished.folder / "reports/comparison.csv")
    # Table II is the mean of two samplings.
    rows = pd.read_csv(finished.folder / "results/studies/noise_block_push.csv")
    for column, samplers in {
        "Deterministic": ["euler", "dpmpp_2s"],
        "Stochastic": ["euler_ancestral", "dpmpp_2s_ancestral"],
    }.items():
        part = rows[rows["sampler"].isin(samplers)]
        row = (
            table[(table["study"] == "noise_block_push") & (table["column"] == column)]
            .set_index("metric")
            .loc["result"]
        )
        assert row["ours"] == pytest.approx(part["result"].mean(), abs=1e-6)
        assert row["episodes"] == len(part) / 2
        assert row["place"] == "Table II"
    rows = pd.read_csv(finished.folder / "results/studies/noise_calvin.csv")
    part = table[table["study"] == "noise_calvin"].set_index(["goals", "column"])
    assert part.index.tolist() == [
        (goals, column) for goals in ("single_tasks", "two_tasks") for column in ("Deterministic", "Stochastic")
    ]
    for goals, expected in rows[~rows["sampler"].str.contains("ancestral")].groupby("goals"):
        assert part.loc[(goals, "Deterministic"), "ours"] == pytest.approx(expected["success"].mean(), abs=1e-6)
        assert part.loc[(goals, "Deterministic"), "episodes"] == len(expected) / 2
    # This profile's studies of samplers have some of the paper's columns, and one of its numbers of steps.
    rows = pd.read_csv(finished.folder / "results/studies/samplers_log_normal_kitchen.csv")
    part = table[(table["place"] == "Table VII") & (table["metric"] == "reward") & table["ours"].notna()]
    assert part[["row", "column"]].values.tolist() == [["Reward, 3 steps", "Heun"], ["Reward, 3 steps", "DDIM"]]
    assert set(part["study"]) == {"samplers_log_normal_kitchen"}
    heun = rows[(rows["sampler"] == "heun") & (rows["steps"] == 3)]
    assert part["ours"].iloc[0] == pytest.approx(heun["reward"].mean(), abs=1e-6)


def test_a_study_of_other_values_is_not_taken_for_the_papers(workspace, monkeypatch):
    workspace.set("studies.schedules_block_push.vary", {"schedule": ["exponential"], "steps": [3]})
    workspace.set("studies.noise_block_push.vary", {"sampler": ["euler", "dpmpp_2s", "euler_ancestral"]})
    workspace.set("studies.samplers_log_normal_kitchen.vary", {"sampler": ["ddim"]})
    for name in ("schedules_block_push", "noise_block_push", "samplers_log_normal_kitchen"):
        workspace.stage("study", name)
    monkeypatch.chdir(workspace.folder)
    table = gather(params.load())["comparison"]
    assert table.loc[table["study"] == "schedules_block_push", "verdict"].eq("not run").all(), "it varies more"
    noise = table[table["study"] == "noise_block_push"].set_index("column")["verdict"].eq("not run")
    assert noise["Stochastic"].all(), "one of two samplers is missing"
    assert not noise["Deterministic"].any()
    samplers = table[(table["place"] == "Table VII") & table["ours"].notna()]
    assert set(samplers["study"]) == {"samplers_kitchen"}, "the next best"


def test_tables_put_ours_beside_the_papers(finished):
    text = (finished.folder / "reports/tables.tex").read_text()
    assert "GCBC & C-IBC & LMP & RIL & C-BeT & CX-Diff & C-BESO & CFG-BESO" in text
    main = text[: text.index("tab:main")]
    # Two metrics: ours of block push and CALVIN, the paper's of block push and the kitchen, and of CALVIN's C-BESO.
    assert len(re.findall(r"\\pm", main)) == 2 * ((2 + 2) * len(METHODS) + 1)
    for number in ("0.13", "0.96", "0.97", "0.93", "0.88"):  # the paper's
        assert f"{number} ($\\pm$" in text
    assert "scripted demonstrations made here" in text
    assert "116,793" in text


def test_tables_have_every_methods_hyperparameters_beside_the_papers(finished):
    text = (finished.folder / "reports/tables.tex").read_text()
    labels = profile.load("smoke").labels
    for method in METHODS:
        assert f"Hyper-parameters: {labels[method]}, Block-Push." in text
    assert r"Counter examples & 8 & 64 * \\" in text
    assert r"Energy penalty & 0.005 & 0.005 \\" in text
    assert r"Sampling: steps & all & all \\" in text  # CX-Diff's whole chain


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="pdflatex is not installed (texlive-latex-recommended)")
def test_report_compiles(workspace):
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "report.tex"],
        cwd=workspace.folder / "reports",
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Undefined" not in done.stdout
    assert (workspace.folder / "reports/report.pdf").stat().st_size > 20_000


class Links(HTMLParser):
    """Collects what a page would load, and checks that tags close."""

    def __init__(self):
        super().__init__()
        self.sources, self.open = [], []

    def handle_starttag(self, tag, attributes):
        self.sources += [value for name, value in attributes if name in ("src", "href", "srcset", "data")]
        if tag not in ("meta", "img", "link", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_whole_and_needs_nothing_else(finished):
    text = (finished.folder / "reports/report.html").read_text()
    links = Links()
    links.feed(text)
    assert links.open == []
    assert links.sources
    assert all(source.startswith(("data:", "#")) for source in links.sources)
    assert "default-src 'none'" in text
    assert "url(" not in text
    assert "@import" not in text
    for part in (
        "Table VIII",
        "Figure 5",
        "All numbers",
        "Studies",
        "Play data",
        "Latency",
        "profile: smoke",
        "torch",
        "scripted",
        "0.96",
    ):
        assert part in text
    assert len(text) < 15e6


def figures_of(folder):
    """Names of the figures on the page, in its order."""
    return re.findall(r'<figure class="plot[^"]*" id="figure-([^"]+)"', (folder / "reports/report.html").read_text())


def assert_each_figure_is_shown_once(folder):
    written = [path for path in (folder / "reports/figures").iterdir() if path.name != "captions.json"]
    for kind in (".png", ".pdf"):
        assert sorted(figures_of(folder)) == sorted(path.stem for path in written if path.suffix == kind)
    text = (folder / "reports/report.html").read_text()
    drawn = [path for path in written if path.suffix == ".png"]
    photos = [path for path in drawn if path.name.startswith(page.PHOTOS)]
    assert text.count('src="data:image/jpeg') == len(photos)
    pictures = Counter(path.read_bytes() for path in drawn if path not in photos)  # two of nothing may be alike
    for picture, count in pictures.items():
        assert text.count(base64.b64encode(picture).decode()) == count


def part(page, place):
    """The page's part with one of the paper's tables or figures."""
    return page.split(f'<section id="{place.replace(" ", "-")}">')[1].split("</section>")[0]


def test_every_figure_is_shown_once_where_the_paper_has_it(finished):
    assert_each_figure_is_shown_once(finished.folder)
    page = (finished.folder / "reports/report.html").read_text()
    for place in places().itertuples():
        for beginning in place.figures.split():
            assert f'id="figure-{beginning}' in part(page, place.name)
    order = figures_of(finished.folder)
    assert order[0] == "overview"
    assert order[-2:] == ["samples_calvin", "probe_calvin"]


def test_the_page_has_every_number_of_the_paper(finished):
    counts = {"Table I": 32, "Table II": 12, "Table IV": 24, "Table VII": 60, "Table VIII": 60, "Text": 7}
    comparison = pd.read_csv(finished.folder / "reports/comparison.csv").query("place.notna()")
    assert comparison["place"].value_counts().to_dict() == counts
    page = (finished.folder / "reports/report.html").read_text()
    listed = page.split('<section id="all-numbers">')[1].split("</section>")[0]
    for place, count in counts.items():
        assert listed.count(f'<td class="text key">{place}</td>') == count
        rows, shown = comparison[comparison["place"] == place], part(page, place)
        papers = re.findall(r'"theirs">([\d.]+)(?:<span class="pm"> &plusmn;([\d.]+)</span>)?</span>', shown)
        assert sorted(float(mean) for mean, _ in papers) == sorted(rows["paper"])
        assert sorted(float(std) for _, std in papers if std) == sorted(rows["paper_std"].dropna())
        assert shown.count('<span class="none">not run</span>') == (rows["verdict"] == "not run").sum()


def nothing_of(values):
    """A profile's file that leaves an environment out: null for it and for each of its cells and studies."""
    parts = ("environments", "images", "cells", "studies")
    return {name: dict.fromkeys(entries) for name, entries in values.items() if name in parts}


def test_a_profile_without_an_environment_leaves_no_broken_place(workspace):
    left_out = nothing_of(YAML(typ="safe").load(workspace.folder / "profiles/paper/calvin.yaml"))
    YAML().dump(left_out, workspace.folder / "profiles/smoke/calvin.yaml")
    workspace.beso("profile", "smoke")
    latency = pd.read_csv(workspace.folder / "timings/latency.csv").query("environment != 'calvin'")
    latency.to_csv(workspace.folder / "timings/latency.csv", index=False)  # as the stage would, but at once
    for stage in ("tables", "page"):
        workspace.stage(stage)
    assert_each_figure_is_shown_once(workspace.folder)
    assert not any("calvin" in name for name in figures_of(workspace.folder))
    page = (workspace.folder / "reports/report.html").read_text()
    links = Links()
    links.feed(page)
    assert links.open == []
    for place in ("Figure 3", "Figure 4"):
        assert "All of it: not in profile smoke; <code>beso profile cpu</code>" in part(page, place)
    assert "No environment of this profile gives its policies images." in page
    assert part(page, "Table II").count('<span class="none">not run</span>') == 4


def test_goal_images_stand_beside_the_rollouts_ends(finished):
    scenes = np.load(finished.folder / "results/scenes/calvin/c_beso.npy")  # (episodes, start, goal and end, H, W, 3)
    goals = np.load(finished.folder / "data/trials/calvin/goal.npy")
    assert np.array_equal(scenes[:, 1], goals[: len(scenes), 0])
    assert scenes.shape == (2, 3, 48, 48, 3)
    assert (scenes[:, 0] != scenes[:, 2]).any(axis=(1, 2, 3)).all(), "something moved"
    page = (finished.folder / "reports/report.html").read_text()
    assert page.count('<figure class="plot photo" id="figure-goals_calvin">') == 1
    assert "CALVIN, an episode of each single task: its start, its goal image" in page


def test_latency_is_measured_for_every_method_at_the_papers_size(finished):
    table = pd.read_csv(finished.folder / "timings/latency.csv")
    assert set(zip(table["method"], table["batch"], strict=True)) == {
        (cell.method, batch) for cell in profile.load("smoke").cells.values() for batch in (1, 4)
    }
    papers = table[table["method"].isin(["cx_diff", "c_beso", "cfg_beso"])]
    assert set(zip(papers["environment"], papers["parameters"], strict=True)) == {
        ("block_push", 2_783_762),
        ("kitchen", 9_381_609),
        ("calvin", 42_938_887),
    }
    assert (table["median_ms"] > 0).all()


def test_the_page_counts_the_parameters_of_variants_beside_their_methods(finished):
    text = part((finished.folder / "reports/report.html").read_text(), "Text")
    counts = re.findall(r"(Block-Push|Relay Kitchen): C-BESO ([\d,]+), C-BESO, FiLM ([\d,]+)", text)
    assert [(name, count) for name, count, _ in counts] == [("Block-Push", "2,783,762"), ("Relay Kitchen", "9,381,609")]
    assert all(int(film.replace(",", "")) > int(count.replace(",", "")) for _, count, film in counts)


def test_films_play_back(tmp_path):
    ramp = np.linspace(0, 255, 64, dtype=np.uint8)
    frames = [
        np.stack([np.tile(ramp, (48, 1)), np.full((48, 64), 10 * i, np.uint8)] * 2, -1)[..., :3] for i in range(9)
    ]
    write_video(tmp_path / "film.webm", frames, 20)
    capture = cv2.VideoCapture(str(tmp_path / "film.webm"))
    decoded = []
    while (read := capture.read())[0]:
        decoded.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    assert len(decoded) == len(frames)
    assert np.abs(decoded[-1].astype(int) - frames[-1]).mean() < 12  # VP8 is lossy
    write_video(tmp_path / "again.webm", frames, 20)
    assert (tmp_path / "again.webm").read_bytes() == (tmp_path / "film.webm").read_bytes()


def test_a_machine_that_cannot_draw_says_so_on_the_page(workspace, monkeypatch):
    def cannot_draw(*arguments):
        raise CannotDrawError("there is no pencil")

    monkeypatch.chdir(workspace.folder)
    write_film(params.load().cell("kitchen", "c_beso").film_folder, cannot_draw, ())
    workspace.stage("page")
    text = (workspace.folder / "reports/report.html").read_text()
    assert "C-BESO in Relay Kitchen: no film. there is no pencil" in text


def test_films_that_the_page_has_no_room_for_are_named(finished, monkeypatch):
    monkeypatch.chdir(finished.folder)
    monkeypatch.setattr(page, "PAGE_BYTES", 0)
    given = params.load()
    text = page.render(given, gather(given), pd.read_csv("timings/latency.csv"))
    assert "The page has no room for it: films/block_push/c_beso/rollout.webm" in text
    assert "<video" not in text


def test_watch_films_an_episode_of_the_evaluation(finished, tmp_path):
    film = tmp_path / "watch.webm"
    command = ("watch", "block_push-c_beso", "--seed", "2", "--episode", "1", "--film", str(film))
    shown = finished.beso(*command).stdout
    rows = pd.read_csv(finished.folder / "results/block_push/c_beso.csv")
    row = rows[(rows["seed"] == 2) & (rows["goals"] == "training") & (rows["episode"] == 1)].iloc[0]
    assert f"goal_demonstration {row['goal_demonstration']}, " in shown
    assert f"length {row['length']}" in shown
    frames, capture = 0, cv2.VideoCapture(str(film))
    while capture.read()[0]:
        frames += 1
    assert frames == row["length"] + 1
    for name in ("watch.mp4", "nowhere/watch.webm"):
        done = finished.beso(*command[:-1], str(tmp_path / name), check=False)
        assert done.stdout == f"error: --film {tmp_path / name}: must be a .webm file in a folder that exists\n"


def test_studies_have_a_row_an_episode_and_sampling_from_the_same_starts(finished):
    rows = pd.read_csv(finished.folder / "results/studies/samplers_block_push.csv")
    varied = ["sampler", "steps"]
    calls = rows.groupby(varied)["calls"].unique().map(list).to_dict()
    assert calls == {("ddim", 2): [2], ("ddim", 3): [3], ("heun", 2): [3], ("heun", 3): [5]}
    parts = {key: part.drop(columns=[*varied, "calls"]).reset_index(drop=True) for key, part in rows.groupby(varied)}
    assert parts.keys() == {("ddim", 2), ("ddim", 3), ("heun", 2), ("heun", 3)}
    same = ["seed", "goals", "episode", "goal_demonstration", "goal_tasks"]
    assert all(part[same].equals(parts["ddim", 3][same]) for part in parts.values())
    # One sampling is the cell's own, and so are its rows: a rollout a seed, with training goals.
    cell = pd.read_csv(finished.folder / "results/block_push/c_beso.csv")
    cell = cell[(cell["goals"] == "training") & (cell["episode"] == 0)].reset_index(drop=True)
    assert parts["ddim", 3].equals(cell)
    assert "Study. Samplers: C-BESO in Block-Push" in (finished.folder / "reports/tables.tex").read_text()
