"""Pages in a real browser: screen, telephone, by night, on paper; without scripts."""

import io
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pypdf import PdfReader

from station.history import courses, read_tests, write_index
from station.notebook.measure import TestedUnit
from station.report.show import write_report
from station.runs.store import open_run
from station.shell.finish import evaluate_run
from tests.browser import Browser, browser_path

pytestmark = pytest.mark.skipif(
    browser_path() is None, reason="no Chromium on this machine (Debian: apt-get install chromium)"
)

PAGES = ("record", "report", "history")
OVERFLOWING = """
[...document.querySelectorAll("body *")].filter(one => {
  const box = one.getBoundingClientRect();
  if (box.width === 0 || box.right <= innerWidth + 1) return false;
  for (let above = one; above; above = above.parentElement)
    if (["auto", "scroll"].includes(getComputedStyle(above).overflowX)) return false;
  return true;
}).map(one => one.outerHTML.slice(0, 80))
"""
TEXTS = """
[...document.querySelectorAll("body *")].filter(one =>
  [...one.childNodes].some(node => node.nodeType === 3 && node.data.trim()) && one.getClientRects().length
).map(one => {
  const svg = one instanceof SVGElement, style = getComputedStyle(one);
  let ground = "rgba(0, 0, 0, 0)";
  for (let above = one; above && /, 0\\)$|transparent/.test(ground); above = above.parentElement)
    ground = getComputedStyle(above).backgroundColor;
  return [one.textContent.trim().slice(0, 40), svg ? style.fill : style.color, ground];
})
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def pages(tested: TestedUnit, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, directory = tmp_path_factory.mktemp("pages"), tested.outcome.directory.parent
    run = tested.outcome.steps[0].run
    assert run is not None
    tests, _ = read_tests(directory)
    return {
        "record": tested.files.page,
        "report": write_report(evaluate_run(open_run(run)), folder / "report.html"),
        "history": write_index(directory, tests, courses(tests), folder / "index.html"),
    }


@pytest.mark.parametrize("page", PAGES)
def test_nothing_is_wider_than_a_telephone(browser: Browser, pages: dict[str, Path], page: str) -> None:
    browser.open(pages[page], width=390, height=844)
    assert browser.say("[document.documentElement.scrollWidth, innerWidth]") == [390, 390]
    assert browser.say(OVERFLOWING) == []


@pytest.mark.parametrize(("width", "height"), [(1200, 900), (390, 844)])
def test_verdict_unit_and_date_are_on_the_first_screen(
    browser: Browser, pages: dict[str, Path], width: int, height: int
) -> None:
    browser.open(pages["record"], width=width, height=height)
    box, text = browser.say(
        "(b => [b.getBoundingClientRect().bottom, b.innerText])(document.querySelector('header'))"
    )
    assert box < height
    assert text.count("PASS") == 1
    assert "SN <7> & Söhne" in text
    assert re.search(r"Tested 20\d\d-\d\d-\d\d", text)


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True], ids=["day", "night"])
@pytest.mark.parametrize("page", PAGES)
def test_every_text_can_be_read(browser: Browser, pages: dict[str, Path], page: str, dark: bool) -> None:
    """WCAG 2.2, 1.4.3: 4.5 to 1 for every text, those of the figures too."""
    browser.open(pages[page], dark=dark)
    texts = browser.say(TEXTS)
    assert len(texts) > 20
    faint = [(text, contrast(ink, ground)) for text, ink, ground in texts if contrast(ink, ground) < 4.5]
    assert faint == []
    assert (luminance(browser.say("getComputedStyle(document.body).backgroundColor")) < 0.1) == dark


def luminance(colour: str) -> float:
    parts = np.array([float(one) for one in re.findall(r"[\d.]+", colour)[:3]]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: str, other: str) -> float:
    dark, light = sorted([luminance(one), luminance(other)])
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.slow
def test_samples_are_seen_under_the_fit(browser: Browser, pages: dict[str, Path], tmp_path: Path) -> None:
    browser.open(pages["report"], width=1200, height=900)
    browser.say("[...document.querySelectorAll('h2')].find(one => one.innerText === 'The beat').scrollIntoView()")
    pixels = np.asarray(Image.open(browser.picture(tmp_path / "beat.png")).convert("RGB"), dtype=float)
    fit = np.abs(pixels - [0x1F, 0x5F, 0x99]).max(axis=2) < 40
    samples = (pixels[..., 0] - pixels[..., 2] > 40) & (pixels[..., 0] > 180)
    assert fit.sum() > 2000
    assert samples.sum() > 2000


@pytest.mark.slow
def test_it_prints_on_a4_with_its_parts_together(browser: Browser, pages: dict[str, Path]) -> None:
    browser.open(pages["record"])
    paper = PdfReader(io.BytesIO(browser.pdf())).pages
    assert {(round(float(one.mediabox.width)), round(float(one.mediabox.height))) for one in paper} == {(595, 842)}
    texts = [one.extract_text() for one in paper]
    for wanted in ("PASS", "SN <7> & Söhne", "Tested 20", "Limits", "Steps", "01 lock-in rate"):
        assert wanted in texts[0]
    # a step begins a page, and no page ends with a heading
    assert texts[1].startswith("01 lock-in rate: Lock-in rate")
    headings = set(browser.say("[...document.querySelectorAll('h2, h3')].map(one => one.innerText)"))
    assert len(headings) > 5
    assert [text.strip().splitlines()[-1] for text in texts if text.strip().splitlines()[-1] in headings] == []


@pytest.mark.slow
def test_what_must_stay_together_fits_on_a_page(browser: Browser, pages: dict[str, Path]) -> None:
    """A part that may not be broken and is longer than a page is broken anywhere."""
    browser.open(pages["record"], width=688, media="print")  # A4 less margins of 14 mm, 96 pixels an inch
    parts = "[...document.querySelectorAll('figure, .verdict, table.facts, tr, section:not(.long, .step)')]"
    heights = browser.say(
        f"{parts}.filter(one => !one.querySelector('section')).map(one => one.offsetHeight || 0)"
    )
    assert max(heights) < 1016


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_it_needs_no_script_and_nothing_from_elsewhere(pages: dict[str, Path], page: str) -> None:
    text = pages[page].read_text(encoding="utf-8")
    assert "<script" not in text
    links = re.findall(r'(?:src|href)="(?!#)([^"]*)"', text)
    assert [one for one in links if not one.endswith("record.html")] == []
    assert "url(http" not in text
