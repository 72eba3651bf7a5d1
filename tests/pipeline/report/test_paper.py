"""reports/paper/numbers.csv and places.csv against the paper's own text."""

import re
from pathlib import Path

import pytest

from beso import envs, methods
from beso.sampling.samplers import SAMPLERS
from beso.sampling.schedules import SCHEDULES
from pipeline.report.comparison import paper_numbers, places

SOURCE = Path(__file__).with_name("paper_tables.tex").read_text()
FLOATS = re.findall(r"\\begin\{((?:table|figure)\*?)\}(.*?)\\end\{\1\}", SOURCE, re.DOTALL)
LABEL = re.compile(r"\\label\{(.*?)\}")
NUMBER = re.compile(r"(\d\.\d+)\}*\s*\(\$\\pm\$ (\d\.\d+)\)")
COUNTS = {
    "tab: GC Simulation Benchmark": 32,
    "tab: noise comparison": 12,
    "tab: noise scheduler ablation": 24,
    "tab: deterministic kitchen sampler study": 60,
    "tab: deterministic push sampler study": 60,
}
METHODS = {
    "GCBC": "gcbc",
    "C-IBC": "c_ibc",
    "LMP": "lmp",
    "RIL": "ril",
    "C-BeT": "c_bet",
    "CX-Diff": "cx_diff",
    "C-BESO": "c_beso",
    "CFG-BESO": "cfg_beso",
}
COLUMNS = {  # what a column's head stands for
    "Euler": "euler",
    "Heun": "heun",
    "DDIM": "ddim",
    "DPM": "dpm_2",
    "DPM++(2S)": "dpmpp_2s",
    "DPM++(2M)": "dpmpp_2m",
}
TABLES = {LABEL.search(text)[1]: text.split(r"\caption")[0] for kind, text in FLOATS if kind.startswith("table")}


def of(label):
    numbers = paper_numbers()
    return numbers[numbers["place"] == label]


def lines(label):
    """The lines of a table that have numbers."""
    return [line for line in TABLES[label].split("\\\\") if NUMBER.search(line)]


def test_places_are_numbered_as_in_the_paper():
    roman = ["I", "II", "III", "IV", "V", "VI", "VII", "VIII"]
    names, tables, figures = {}, iter(roman), iter(range(1, 10))
    for kind, text in FLOATS:
        label = LABEL.search(text)[1]
        names[label] = f"Table {next(tables)}" if kind.startswith("table") else f"Figure {next(figures)}"
    found = places()
    assert list(found["label"].drop(found.index[found["label"] == "text"])) == list(names)
    assert {r.label: r.name for r in found.itertuples(index=False) if r.label != "text"} == names


@pytest.mark.parametrize("label", COUNTS)
def test_numbers_are_those_of_the_papers_tables_in_their_order(label):
    printed = [(float(mean), float(std)) for mean, std in NUMBER.findall(TABLES[label])]
    assert len(printed) == COUNTS[label]
    numbers = of(label)
    assert list(zip(numbers["mean"], numbers["std"], strict=True)) == printed
    in_calvin = numbers["environment"] == "calvin"
    assert set(numbers["seeds"][~in_calvin]) == {10}
    assert set(numbers["seeds"][in_calvin]) <= {3}


def test_no_table_and_no_number_is_left_out():
    assert {label for label, text in TABLES.items() if NUMBER.search(text)} == {*COUNTS}
    assert len(of("text")) == 7
    assert len(paper_numbers()) == sum(COUNTS.values()) + 7 == 195


def test_numbers_in_the_text():
    prose = re.sub(r"\\begin\{(table|figure)\*?\}.*?\\end\{\1\*?\}", "", SOURCE, flags=re.DOTALL)
    printed = re.findall(r"\$(\d\.\d+)(?: \(\\pm (\d\.\d+)\))?\$", prose)
    assert sorted(printed) == sorted(
        (f"{row.mean:g}", "" if row.std != row.std else f"{row.std:g}") for row in of("text").itertuples()
    )


def test_main_table_by_row_and_column():
    numbers = of("tab: GC Simulation Benchmark").set_index(["row", "column"])
    rows = [f"{place} {metric}" for place in ("Block-Push", "Relay-Kitchen") for metric in ("Reward", "Result")]
    for row, line in zip(rows, lines("tab: GC Simulation Benchmark"), strict=True):
        assert row.split()[1] in line
        for (column, method), (mean, _) in zip(METHODS.items(), NUMBER.findall(line), strict=True):
            number = numbers.loc[(row, column)]
            assert (number["method"], number["mean"]) == (method, float(mean))
            assert number["metric"] == row.split()[1].lower()
            assert number["environment"] == {"Block-Push": "block_push", "Relay-Kitchen": "kitchen"}[row.split()[0]]


@pytest.mark.parametrize(
    ("label", "environment"),
    [("tab: deterministic kitchen sampler study", "kitchen"), ("tab: deterministic push sampler study", "block_push")],
)
def test_sampler_tables_by_row_and_column(label, environment):
    numbers = of(label).set_index(["metric", "values"])
    # The captions give the log-normal noise; a run without such a model shows its own.
    assert set(numbers["study"]) == {f"samplers_log_normal_{environment}|samplers_{environment}"}
    assert set(numbers["environment"]) == {environment}
    for i, line in enumerate(lines(label)):
        metric, steps = ("reward", "result")[i // 5], re.search(r"&\s*(\d+)\s*&", line)[1]
        for sampler, (mean, std) in zip(COLUMNS.values(), NUMBER.findall(line.replace("  (", " (")), strict=True):
            number = numbers.loc[(metric, f"sampler={sampler} steps={steps}")]
            assert (number["mean"], number["std"]) == (float(mean), float(std))


def test_time_steps_and_noise_by_row_and_column():
    numbers = of("tab: noise scheduler ablation").set_index(["values", "environment", "metric"])
    for line in lines("tab: noise scheduler ablation"):
        schedule = re.search(r"(\w+)\s*(\\cite|&)", line)[1].lower()
        schedule += "_published" if schedule in ("ve", "vp") else ""  # the paper's are the published code's
        keys = [(place, metric) for place in ("block_push", "kitchen") for metric in ("reward", "result")]
        for key, (mean, _) in zip(keys, NUMBER.findall(line), strict=True):
            assert numbers.loc[(f"schedule={schedule}", *key)]["mean"] == float(mean)
    numbers = of("tab: noise comparison")
    assert numbers["column"].tolist() == ["Deterministic", "Stochastic"] * 6
    assert numbers["values"].str.contains("ancestral").tolist() == [False, True] * 6


def test_names_are_those_of_params_and_of_the_rooms():
    numbers = paper_numbers()
    for pair in {pair for values in numbers["values"] for pair in values.split()}:
        key, values = pair.split("=")
        known = {"sampler": SAMPLERS, "schedule": SCHEDULES}.get(key)
        assert known is None or {*values.split("|")} <= {*known}
    assert set(numbers["method"]) - {*methods.names()} == {"c_beso_film"}
    for name in {*envs.names()} & {*numbers["environment"]}:
        part, metrics = numbers[numbers["environment"] == name], {m.name: m for m in envs.report(name).METRICS}
        assert {*part["metric"]} <= {*metrics}
        assert {*part["goals"]} <= {*envs.spec(name).goal_sets}
        assert all(metrics[row.metric].maximum == row.maximum for row in part.itertuples())
