"""The panel in Chromium: start, see values move, verdict, two tabs, a killed panel, nothing that overflows."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from station.panel.server import languages
from tests.browser import Browser, browser_path

sys.path.insert(0, str(Path(__file__).parent))
from visitor import Visitor, running_panel

pytestmark = pytest.mark.skipif(browser_path() is None, reason="there is no Chromium on this machine")

PLACES = ("/", "/measure/measure", "/measure/threshold", "/station", "/runs", "/bench")
BROKEN = """
[...document.querySelectorAll("body *")].filter(one => one.getBoundingClientRect().right > innerWidth + 1
    && !one.closest(".wide, .said, canvas, option, .hidden")).map(one => one.outerHTML.slice(0, 80))
"""
PALE = """
(() => {
  const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (text) => { const [r, g, b] = numbers(text).map(c => (c /= 255) <= 0.03928 ? c / 12.92
      : ((c + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = (one) => { for (; one; one = one.parentElement) {
      const colour = getComputedStyle(one).backgroundColor; if (!/, 0\\)$/.test(colour)) return colour; }
    return "rgb(255,255,255)"; };
  return [...document.querySelectorAll("main *, header *")].filter(one => [...one.childNodes].some(
      part => part.nodeType === 3 && part.textContent.trim()) && one.offsetParent && !one.disabled).filter(one => {
    const [a, b] = [light(getComputedStyle(one).color), light(ground(one))];
    return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5; }).map(one => one.outerHTML.slice(0, 80));
})()
"""


DRAWN = """document.getElementById('screen').getContext('2d').getImageData(0, 0, 1000, 640).data.some(
    one => one > 200)"""
ENTER = """document.getElementsByName('unit')[0].value = '{}';
document.getElementById('unit-form').requestSubmit()"""


def until(
    browser: Browser, expression: str, holds: Callable[[object], object] = bool, seconds: float = 90
) -> object:
    end = time.monotonic() + seconds
    while not holds(found := browser.say(expression)):
        assert time.monotonic() < end, (expression, found, browser.say("document.body.innerText"))
        time.sleep(0.1)
    return found


@pytest.mark.slow
def test_every_page_fits_every_screen_in_both_languages(tmp_path: Path) -> None:
    with running_panel(tmp_path) as addresses, Browser(tmp_path / "profile") as browser:
        base = addresses["control"].partition("/?")[0]
        browser.visit(addresses["control"])
        for code in languages():
            browser.visit(f"{base}/language/{code}")
            for place in PLACES:
                for width, dark in ((360, False), (768, True), (1920, False)):
                    browser.visit(f"{base}{place}", width=width, dark=dark)
                    assert browser.say(BROKEN) == [], (code, place, width)
                    assert browser.say("document.documentElement.scrollWidth <= innerWidth")
                    assert browser.say(PALE) == [], (code, place, width, dark)
        # everything that can be used is reached by the keyboard, and says what it is
        unnamed = """[...document.querySelectorAll("input:not([type=hidden]), select, button, a")].filter(one =>
            one.tabIndex < 0 || !(one.innerText || one.ariaLabel || (one.labels || []).length)).length"""
        assert browser.say(unnamed) == 0
        assert browser.troubles == []


@pytest.mark.slow
def test_from_the_button_to_the_result_with_a_killed_panel_between(tmp_path: Path) -> None:
    port = ""
    with Browser(tmp_path / "profile") as browser:
        with running_panel(tmp_path) as addresses:
            port = addresses["control"].split(":")[2].partition("/")[0]
            browser.visit(addresses["control"])
            browser.visit(f"{addresses['control'].partition('/?')[0]}/measure/measure")
            browser.say("document.getElementsByName('measurement.records')[0].value = '500'")
            browser.say("document.getElementsByName('measurement.rates_over_lock_in')[0].value = '8'")
            browser.say("document.querySelector('button.large').click()")
            first = until(browser, "document.querySelector('.values .strong')?.innerText")
            until(
                browser, "document.querySelector('.values .strong')?.innerText", lambda now: now and now != first
            )
            assert browser.say(DRAWN)
            # a second reader sees the same, and may not touch it
            other = Visitor(addresses["look"])
            assert "records saved" in other.until("/", lambda text: "records saved" in text)
        until(browser, "!document.getElementById('off').hidden")
        with running_panel(tmp_path, "--port", port):
            until(browser, "document.getElementById('off').hidden")
            until(
                browser, "document.querySelector('.result .value')?.innerText", lambda text: "deg/s" in str(text)
            )
            until(browser, "document.getElementById('while-alive').hidden")
        gone = "ERR_CONNECTION", "ERR_INCOMPLETE"  # what the browser says of a panel that was away
        assert [one for one in browser.troubles if not any(word in str(one) for word in gone)] == []


def test_a_verdict_in_the_station_and_the_next_unit(tmp_path: Path) -> None:
    campaign = (Path(__file__).parents[3] / "config" / "campaign.toml").read_text(encoding="utf-8")
    head, _, steps = campaign.partition("[[step]]")
    (tmp_path / "own.toml").write_text(f"{head}[[step]]{steps.partition('[[step]]')[0]}", encoding="utf-8")
    with running_panel(tmp_path) as addresses, Browser(tmp_path / "profile") as browser:
        browser.visit(addresses["control"])
        browser.visit(f"{addresses['control'].partition('/?')[0]}/station", width=1200)
        browser.say(ENTER.format("RLG-003"))
        assert until(browser, "document.querySelector('.verdict-full')?.innerText") == "FAIL"
        width = browser.say("document.querySelector('.verdict-full').getBoundingClientRect().width")
        assert width > 900
        until(browser, "!document.getElementsByName('unit')[0].disabled")
        browser.say(ENTER.format("RLG-001"))
        assert until(browser, "document.querySelector('.verdict-full')?.innerText", lambda word: word == "PASS")
        assert browser.troubles == []


@pytest.mark.slow
def test_a_cable_that_is_pulled_and_plugged_in_again(tmp_path: Path) -> None:
    def serve(port: str) -> tuple[subprocess.Popen[str], str]:
        words = [sys.executable, "-m", "station.cli", "simulate", "--tcp", port]
        served = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert served.stdout is not None
        with served.stdout as said:
            return served, said.readline().strip()

    served, name = serve("0")
    try:
        with running_panel(tmp_path) as addresses, Browser(tmp_path / "profile") as browser:
            browser.visit(addresses["control"])
            browser.visit(f"{addresses['control'].partition('/?')[0]}/measure/measure?real=1")
            given = {
                "scope.resource": name, "gyro.scale_factor_pulses_per_deg": "2000", "measurement.records": "900",
                "measurement.rates_over_lock_in": "8",
            }  # fmt: skip
            for place, text in given.items():
                browser.say(f"document.getElementsByName('{place}')[0].value = '{text}'")
            browser.say("document.querySelector('button.large').click()")
            until(browser, "document.querySelector('.values .strong')?.innerText")
            served.kill()
            served.wait()
            until(browser, "document.getElementById('view').innerText.includes('The link is down')")
            served, again = serve(name.split("::")[2])
            assert again == name
            until(browser, "document.getElementById('view').innerText.includes('opened again 1')")
            before = "+document.getElementById('view').innerText.match(/(\\d+) records saved/)[1]"
            count = browser.say(before)
            until(browser, before, lambda now: now > count)
            browser.say("document.querySelector('button.stop').click()")
            until(browser, "document.getElementById('view')?.innerText.includes('ended with exit code')")
            assert browser.troubles == []
    finally:
        served.kill()
        served.wait()
