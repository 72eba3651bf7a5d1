"""The page in a browser: it loads without errors and without a network, sorts, zooms, plays, and fits a phone."""

import shutil

import pandas as pd
import pytest
from playwright.sync_api import sync_playwright

pytestmark = pytest.mark.browser

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SWITCHES = ("--host-resolver-rules=MAP * ~NOTFOUND", "--autoplay-policy=no-user-gesture-required")


class Browser:
    """One page at a time in a Chromium of its own.

    Attributes:
        messages: what the page wrote to the console, and its errors.
        requests: addresses that the page asked for.
    """

    def __init__(self, chromium):
        self._chromium, self.page = chromium, None

    def open(self, path, width=1200, height=900, dark=False):
        """Load a local file in a new window of a size."""
        if self.page:
            self.page.context.close()
        self.messages, self.requests = [], []
        window, scheme = {"width": width, "height": height}, "dark" if dark else "light"
        self.page = self._chromium.new_page(viewport=window, is_mobile=width < 600, color_scheme=scheme)
        self.page.on("console", lambda message: self.messages.append(message.text))
        self.page.on("pageerror", lambda error: self.messages.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())

    def run(self, expression):
        """The value of a JavaScript expression; a promise's once it has one."""
        return self.page.evaluate(expression)


@pytest.fixture(scope="module")
def page(finished):
    return finished.folder / "reports/report.html"


@pytest.fixture(scope="module")
def browser():
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.fail(
            f"no Chromium found ({', '.join(NAMES)}): install one (Debian: apt-get install chromium), or leave these"
            " tests out with `pytest -m 'not browser'`",
            pytrace=False,
        )
    with sync_playwright() as library, library.chromium.launch(executable_path=program, args=SWITCHES) as chromium:
        yield Browser(chromium)


def test_loads_without_errors_and_asks_nothing_of_a_network(browser, page):
    browser.open(page)
    browser.run("window.scrollTo(0, document.body.scrollHeight)")
    for figure in ("img", "video"):
        assert browser.run(f"document.querySelectorAll('{figure}').length") > 0
    broken = "[...document.images].filter((image) => image.src && !(image.complete && image.naturalWidth)).length"
    assert browser.run(broken) == 0
    assert browser.messages == []
    assert [url for url in browser.requests if not url.startswith("data:")] == [page.as_uri()]


def test_a_page_that_errs_or_asks_is_caught(browser, tmp_path):
    """What the test above relies on."""
    bad = tmp_path / "bad.html"
    bad.write_text("<!doctype html><script>missing()</script><img src='https://example.org/picture.png'>")
    browser.open(bad)
    assert any("missing is not defined" in message for message in browser.messages)
    assert "https://example.org/picture.png" in browser.requests
    assert browser.run("document.images[0].naturalWidth") == 0


@pytest.fixture(scope="module")
def verdicts(finished):
    """How many of the paper's numbers have each verdict."""
    return pd.read_csv(finished.folder / "reports/comparison.csv").query("place.notna()")["verdict"].value_counts()


def test_tables_sort(browser, page, verdicts):
    browser.open(page)
    column = """[...document.querySelectorAll('#all-numbers tbody tr')].filter((row) => !row.hidden)
        .map((row) => row.cells[3].dataset.sort).map(Number)"""
    click = "document.querySelectorAll('#all-numbers th button')[3].click()"
    before = browser.run(column)
    assert len(before) == verdicts.drop(["not run", "timed apart"]).sum() > 30
    browser.run(click)
    assert browser.run(column) == sorted(before)
    browser.run(click)
    assert browser.run(column) == sorted(before, reverse=True)
    assert browser.run("document.querySelector('#all-numbers th[aria-sort]').ariaSort") == "descending"
    assert browser.run("document.querySelectorAll('table.sortable').length") >= 3


def test_all_numbers_can_be_chosen_from(browser, page, verdicts):
    browser.open(page)
    shown = "[...document.querySelectorAll('#all-numbers tbody tr')].filter((row) => !row.hidden).length"
    browser.run("(verdict.value = '', verdict.dispatchEvent(new Event('change')))")
    assert browser.run(shown) == 195
    browser.run("(verdict.value = 'not run', verdict.dispatchEvent(new Event('change')))")
    assert browser.run(shown) == verdicts["not run"]
    browser.run("(words.value = 'table viii heun', words.dispatchEvent(new Event('input')))")
    assert browser.run(shown) == 10 - 2


def test_figures_zoom(browser, page):
    browser.open(page)
    browser.run("document.querySelectorAll('.plot img')[1].click()")
    assert browser.run("document.querySelector('dialog').open")
    width = "document.querySelector('dialog img').getBoundingClientRect().width"
    assert browser.run(width) > browser.run("document.querySelectorAll('.plot img')[1].clientWidth")
    browser.run("document.querySelector('dialog img').click()")
    assert browser.run(width) == browser.run("document.querySelector('dialog img').naturalWidth")
    browser.run("document.querySelector('dialog button').click()")
    assert not browser.run("document.querySelector('dialog').open")


def test_films_play(browser, page):
    browser.open(page)
    played = browser.run(
        """Promise.all([...document.querySelectorAll('video')].map(async (film) => {
            await film.play();
            await new Promise((resolve) => film.requestVideoFrameCallback(resolve));
            return [film.error, film.videoWidth, film.duration];
        }))"""
    )
    assert played
    for error, width, duration in played:
        assert error is None
        assert width >= 100
        assert duration > 0.3


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [320, 390, 1200])
def test_fits_the_window_in_light_and_dark(browser, page, width, dark):
    browser.open(page, width, 844, dark)
    for details in ("false", "true"):
        browser.run(f"document.querySelectorAll('details').forEach((part) => part.open = {details})")
        assert browser.run("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    if width == 1200:  # tables move sideways on phones alone
        wide = "[...document.querySelectorAll('.wide')].filter((box) => box.scrollWidth > box.clientWidth).length"
        assert browser.run(wide) == 0
    ink, paper = (browser.run(f"getComputedStyle(document.body).{name}") for name in ("color", "backgroundColor"))
    assert (sum(channels(ink)) > sum(channels(paper))) == dark
    assert contrast(channels(ink), channels(paper)) > 7


def channels(colour):
    return [int(part) for part in colour.removeprefix("rgb(").removesuffix(")").split(",")]


def contrast(first, second):
    """The contrast ratio of WCAG 2."""

    def luminance(colour):
        parts = [c / 255 / 12.92 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
        return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), parts, strict=True))

    light, dark = sorted((luminance(first), luminance(second)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_contents_lead_to_every_table_and_figure_of_the_paper(browser, page):
    browser.open(page)
    links = browser.run("[...document.querySelectorAll('nav a')].map((link) => [link.textContent, link.hash])")
    texts = " | ".join(text for text, _ in links)
    for name in (
        "Table I ",
        "Table II ",
        "Table III ",
        "Table IV ",
        "Table V ",
        "Table VI ",
        "Table VII ",
        "Table VIII ",
    ):
        assert name in texts
    assert all(f"Figure {n} " in texts for n in range(1, 6))
    for _, anchor in links:
        assert browser.run(f"document.querySelectorAll({anchor!r}).length") == 1
