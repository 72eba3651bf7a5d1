import matplotlib
import pandas as pd
import pytest

from pipeline import profile
from pipeline.report.figures import STYLE, overview

METHODS = ["gcbc", "c_ibc", "lmp", "ril", "c_bet", "cx_diff", "c_beso", "cfg_beso", "c_beso_film"]
COLUMNS = ["environment", "metric", "method", "study", "ours", "ours_low", "ours_high", "paper", "paper_std"]


def drawn(*rows):
    return overview(profile.load("smoke"), pd.DataFrame(rows, columns=COLUMNS))


def test_the_overview_has_a_panel_a_metric_and_the_methods_that_have_numbers():
    cells = [
        ("kitchen", "result", "c_beso", None, 2.0, 1.0, 4.0, 3.75, 0.05),
        ("kitchen", "result", "gcbc", None, 1.0, 0.5, 2.0, 2.57, None),
        ("kitchen", "result", "lmp", None, None, None, None, 1.41, 0.1),
        ("block_push", "reward", "c_beso", "noise_block_push", 0.5, 0.4, 0.6, 0.96, 0.02),
    ]
    figure = drawn(*cells)
    titles = [axis.get_title() for axis in figure.axes]
    assert titles == ["Block-Push,\nReward", "Relay Kitchen,\nResult"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["GCBC", "C-BESO"]
    points = {tuple(line.get_xydata()[0]) for line in figure.axes[1].lines[1:] if len(line.get_xydata())}
    assert {(3.75 / 4, 0.5), (2.57 / 4, 0.25)} <= points, "shares of the largest value"


def test_the_overview_of_a_run_beside_which_the_paper_has_nothing_is_empty():
    figure = drawn(("kitchen", "result", "c_beso_film", None, 2.0, 1.0, 3.0, None, None))
    assert [axis.get_title() for axis in figure.axes] == [""]


def test_the_overview_draws_every_method_that_the_paper_has():
    with matplotlib.rc_context(STYLE):
        figure = drawn(*[("block_push", "result", method, None, 0.5, 0.4, 0.6, 0.9, 0.1) for method in METHODS])
        figure.draw_without_rendering()
    (legend,) = figure.legends
    assert len(legend.get_texts()) == len(METHODS)
    assert 0 <= legend.get_window_extent().x0 < legend.get_window_extent().x1 <= figure.bbox.x1
    looks = {(line.get_marker(), line.get_color()) for line in legend.get_lines()}
    assert len(looks) == len(METHODS)


@pytest.mark.parametrize("methods", [["c_beso"], METHODS], ids=["one", "all"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_no_text_of_the_overview_is_cut_off_or_under_the_legend(count, methods):
    metrics = [("block_push", "reward"), ("block_push", "result"), ("calvin", "success")]
    metrics += [("kitchen", "reward"), ("kitchen", "result")]
    with matplotlib.rc_context(STYLE):
        figure = drawn(*[(*m, name, None, 0.5, 0.4, 0.6, 0.9, 0.1) for m in metrics[:count] for name in methods])
        figure.draw_without_rendering()
    (legend,) = figure.legends
    top_of_legend = legend.get_window_extent().y1
    for axis in figure.axes:
        assert axis.title.get_window_extent().y1 <= figure.bbox.y1
        assert axis.xaxis.label.get_window_extent().y0 >= top_of_legend
