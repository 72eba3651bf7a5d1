from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from beso.errors import UserError
from pipeline import compare

PARAMS = """
seed: 0
methods: {{gcbc: {{label: GCBC}}, c_beso: {{label: C-BESO, steps: {steps}}}}}
cells:
  block_push-gcbc: {{env: block_push, method: gcbc}}
  block_push-c_beso: {{env: block_push, method: c_beso}}
studies:
  solvers: {{env: block_push, method: c_beso, of: c_beso, vary: {{sampler: [ddim, heun]}}}}
"""


def episodes(rate, seeds=(1, 2, 3), count=40, draws=0):
    """Rows whose results are above `rate` where a number that depends on seed and episode alone is."""
    rows = []
    for seed in seeds:
        ranks = np.random.default_rng((draws, seed)).random(count)
        for goals in ("training", "held_out"):
            rows += [
                {"seed": seed, "goals": goals, "episode": i, "reward": float(rank < rate), "result": float(rank < rate)}
                for i, rank in enumerate(ranks)
            ]
    return pd.DataFrame(rows)


@pytest.fixture
def run(tmp_path):
    def make(name, cells, solvers=None, steps=3):
        folder = tmp_path / name
        (folder / "results/block_push").mkdir(parents=True)
        (folder / "params.yaml").write_text(PARAMS.format(steps=steps))
        for method, rows in cells.items():
            rows.to_csv(folder / f"results/block_push/{method}.csv", index=False)
        if solvers:
            (folder / "results/studies").mkdir()
            parts = [rows.assign(sampler=sampler) for sampler, rows in solvers.items()]
            pd.concat(parts).to_csv(folder / "results/studies/solvers.csv", index=False)
        return str(folder)

    return make


def lines(*folders):
    return {
        (line.source.method, line.source.changes, line.goals, line.metric.name): line
        for line in compare.compare(*map(compare.load, folders))
    }


def told(*folders, markdown=False):
    return compare.report(("A", "B"), tuple(map(compare.load, folders)), markdown)


def test_runs_are_paired_episode_by_episode(run):
    found = lines(run("a", {"c_beso": episodes(0.5)}), run("b", {"c_beso": episodes(0.7)}))
    assert len(found) == 4  # goal sets, metrics
    line = found["c_beso", "", "training", "result"]
    assert line.pairs == 3 * 40
    assert line.change.mean == pytest.approx(line.second - line.first)
    assert 0 < line.change.low < 0.2 < line.change.high


def test_pairs_are_of_the_seeds_and_episodes_that_both_have(run):
    a, b = (
        run("a", {"gcbc": episodes(0.5, (1, 2), 40)}),
        run("b", {"gcbc": episodes(0.5, (2, 3), 40).query("episode<30")}),
    )
    line = lines(a, b)["gcbc", "", "training", "result"]
    assert line.pairs == 30
    assert line.first == line.second
    assert line.change.mean == 0


def test_runs_without_common_seeds_are_compared_by_their_means(run):
    a, b = run("a", {"gcbc": episodes(0.2, (1, 2, 3))}), run("b", {"gcbc": episodes(0.9, (4, 5, 6))})
    line = lines(a, b)["gcbc", "", "training", "result"]
    assert line.pairs == 0
    assert line.change.low < 0.7 < line.change.high
    assert "none" in told(a, b)


def test_studies_are_compared_sampling_by_sampling(run):
    a = run("a", {}, {"ddim": episodes(0.5), "heun": episodes(0.5)})
    b = run("b", {}, {"ddim": episodes(0.5), "heun": episodes(0.9)})
    found = lines(a, b)
    assert found["c_beso", "solvers: DDIM", "training", "result"].change.mean == 0
    assert found["c_beso", "solvers: Heun", "training", "result"].change.low > 0


def test_the_report_says_what_differs(run):
    a = run("a", {"gcbc": episodes(0.5), "c_beso": episodes(0.3)})
    b = run("b", {"c_beso": episodes(0.9)}, steps=5)
    text = told(a, b)
    (row,) = [line.split("  ") for line in text.splitlines() if "training goals" in line and "Result" in line]
    row = [part.strip() for part in row if part.strip()]
    assert row[:4] == ["Block-Push", "C-BESO", "training goals", "Result"]
    assert row[8:] == ["better", "120"]
    assert "4 of 4 differences are beyond chance" in text
    assert "Only A has episodes of: block_push gcbc." in text
    assert "Parameters that differ: 1\n  methods.c_beso.steps: 3 -> 5" in text
    assert "Of one seed" not in text
    table = [line for line in told(a, b, markdown=True).splitlines() if line.startswith("|")]
    assert len(table) == 2 + 4
    assert len({line.count("|") for line in table}) == 1


def test_two_runs_that_differ_in_nothing_say_so(run):
    a, b = run("a", {"gcbc": episodes(0.5)}), run("b", {"gcbc": episodes(0.5)})
    assert told(a, b) == "A and B do not differ: the same in all 240 episodes.\nNo parameter differs."


@pytest.mark.parametrize("name", ["nowhere", "--help", "HEAD:nowhere"])
def test_what_is_no_run_is_one_line(name):
    with pytest.raises(UserError, match=r"neither a folder nor a git revision|no params\.yaml there"):
        compare.load(name)


def test_other_parameters_are_no_runs(tmp_path):
    (tmp_path / "params.yaml").write_text("seed: 0\n")
    with pytest.raises(UserError, match="names no methods"):
        compare.load(str(tmp_path))


def test_runs_without_results_or_anything_in_common_are_one_line(run, tmp_path):
    a, b = run("a", {"gcbc": episodes(0.5)}), run("b", {"c_beso": episodes(0.5)})
    with pytest.raises(UserError, match="no results of the same cell"):
        told(a, b)
    with pytest.raises(UserError, match="no results there"):
        compare.load(run("c", {}))
    (Path(a) / "results/block_push/gcbc.csv").write_text("")
    with pytest.raises(UserError, match=r"results/block_push/gcbc\.csv is empty"):
        compare.load(a)
    (Path(a) / "results/block_push/gcbc.csv").write_text("seed,goals,result\n1,training,1\n")
    with pytest.raises(UserError, match=r"results/block_push/gcbc\.csv has no column episode"):
        compare.load(a)


def test_results_of_cells_that_params_no_longer_name_are_left_over(run):
    folder = run("a", {"gcbc": episodes(0.5), "c_beso": episodes(0.5)})
    params = Path(folder) / "params.yaml"
    params.write_text(params.read_text().replace("  block_push-c_beso: {env: block_push, method: c_beso}\n", ""))
    assert {method for method, *_ in lines(folder, folder)} == {"gcbc"}


def test_revisions_have_episodes_through_dvc(small):
    done = small.beso("compare", "HEAD", ".")
    assert "HEAD and . do not differ: the same in all 32 episodes." not in done.stdout  # the studies' rows count too
    assert "HEAD and . do not differ: the same in all " in done.stdout
    small.set("methods.c_beso.sample.block_push.sampler", "euler_ancestral")
    small.repro("evaluate@block_push-c_beso")
    done = small.beso("compare", "HEAD", ".", "--markdown")
    assert "| Block-Push | C-BESO | training goals | Result |" in done.stdout
    assert "methods.c_beso.sample.block_push.sampler: (none) -> euler_ancestral" in done.stdout
    small.run("rm", "-r", ".dvc/cache")
    done = small.beso("compare", "HEAD", ".", check=False)
    assert (done.returncode, done.stdout.startswith("error: HEAD: no results there: run `dvc repro`")) == (1, True)
    done = small.beso("compare", ".", "nothing", check=False)
    assert (done.returncode, done.stdout) == (1, "error: nothing: neither a folder nor a git revision\n")


def test_an_episode_that_is_there_twice_is_refused(run):
    whole = episodes(0.5)
    cell, study = run("a", {"gcbc": pd.concat([whole, whole[:1]])}), run("b", {}, {"ddim": pd.concat([whole, whole])})
    for folder, name in ((cell, "block_push/gcbc.csv has seed 1"), (study, "solvers.csv has sampler ddim, seed 1")):
        with pytest.raises(UserError, match=rf"{name}, goals training, episode 0 twice"):
            compare.load(folder)
