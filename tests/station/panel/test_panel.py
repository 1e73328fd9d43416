"""`gyrolock panel`: what visitors may do, what buttons do, and that measurements do not depend on the panel."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest

from station.panel.guard import LARGEST_BODY
from station.panel.server import checked, form_of, languages, measurements, settings_text, words

sys.path.insert(0, str(Path(__file__).parent))
from visitor import Visitor, environment, running_panel

from tests.small_campaign import write_campaign

SHORT = {"measurement.records": "8", "measurement.tilt_records": "1", "measurement.rates_over_lock_in": "8"}


@pytest.fixture
def panel(tmp_path: Path) -> Iterator[dict[str, str]]:
    with running_panel(tmp_path) as addresses:
        yield addresses


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """A panel for tests that take no control: one that does shuts the others out for half a minute."""
    with running_panel(tmp_path_factory.mktemp("panel")) as addresses:
        yield addresses


# ---- who may do what


def test_who_may_look_and_who_may_act(shared: dict[str, str]) -> None:
    control, look = Visitor(shared["control"]), Visitor(shared["look"])
    assert (control.status, look.status) == (200, 200)
    assert "script-src 'self'" in control.headers["content-security-policy"]
    assert "unsafe" not in control.headers["content-security-policy"]
    assert control.headers["x-content-type-options"] == "nosniff"
    assert "disabled" in look.get("/measure/measure")
    assert look.ask("POST", "/bench/list")[0] == 403
    stranger = Visitor(f"{shared['control'].partition('?')[0]}?token=wrong")
    assert stranger.status == 403
    assert stranger.ask("GET", "/static/panel.js")[0] == 403
    assert control.ask("GET", "/", Host="evil.example")[0] == 421
    assert control.ask("POST", "/bench/list", Origin="http://evil.example")[0] == 403
    assert control.ask("POST", "/bench/list", "x" * (LARGEST_BODY + 1))[0] == 413
    assert control.ask("POST", "/measure/nonsense")[0] == 400
    control.post("/control/give")
    for nowhere in ("/nonsense", "/job/x/y"):
        status, _, text = control.ask("GET", nowhere)
        assert status == 404 and "There is no such page." in text


def test_a_body_without_length_is_cut_off(shared: dict[str, str]) -> None:
    visitor = Visitor(shared["control"])
    name, _, port = visitor.host.partition(":")
    cookies = "; ".join(f"{key}={value}" for key, value in visitor.cookies.items())
    with socket.create_connection((name, int(port)), timeout=20) as line:
        head = f"POST /runs/note HTTP/1.1\r\nHost: {visitor.host}\r\nCookie: {cookies}\r\n"
        line.sendall(f"{head}Transfer-Encoding: chunked\r\n\r\n".encode())
        piece = b"1000\r\n" + b"x" * 0x1000 + b"\r\n"
        sent = 0
        try:
            while sent < 100 * LARGEST_BODY:
                line.sendall(piece)
                sent += 0x1000
        except OSError:
            pass
    assert sent < 100 * LARGEST_BODY
    assert visitor.get("/runs") and visitor.status == 200


def test_files_outside_are_not_shown(tmp_path: Path) -> None:
    outside = "../secret.html", "%2e%2e/secret.html", ".gyrolock-panel/tokens.json", "/etc/passwd"
    (tmp_path / "inside").mkdir()
    (tmp_path / "secret.html").write_text("<p>secret</p>", encoding="utf-8")
    with running_panel(tmp_path / "inside") as addresses:
        visitor = Visitor(addresses["control"])
        for path in outside:
            text = visitor.get(f"/file/{path}")
            assert "<p>secret" not in text and "root:" not in text and '"control":' not in text
            assert visitor.status in (400, 404)


def test_one_holds_the_control_and_gives_it_away(panel: dict[str, str]) -> None:
    first, second = Visitor(panel["control"]), Visitor(panel["control"])
    assert "You have the control" in first.post("/control/take", name="<b>Ann</b>")
    assert "&lt;b&gt;Ann&lt;/b&gt; has the control" in second.get("/")
    assert "has the control: ask for it first" in second.post("/bench/list")
    assert second.status == 409
    second.post("/control/ask", name="Bo")
    assert "Bo asks for the control" in first.get("/")
    first.post("/control/give")
    assert "You have the control" in second.post("/control/take", name="Bo")


@pytest.mark.slow
def test_the_language_of_the_browser_and_the_one_that_is_chosen(shared: dict[str, str]) -> None:
    visitor = Visitor(shared["control"])
    assert 'lang="zh"' in visitor.ask("GET", "/", Accept_Language="zh-CN,en;q=0.5")[2][:60]
    assert 'lang="en"' in visitor.ask("GET", "/", Accept_Language="fi")[2][:60]
    visitor.ask("GET", "/language/zh")
    assert words("zh")["nothing_runs"] in visitor.get("/")


# ---- forms


def test_the_help_of_every_setting_stands_in_every_language() -> None:
    helps = {
        one.help
        for name in measurements()
        for real in (False, True)
        for section in form_of(name, real=real)
        for one in section.fields
        if one.help
    }
    for code in languages():
        assert code == "en" or set(words(code)["help"]) == helps


@pytest.mark.parametrize("name", measurements())
@pytest.mark.parametrize("real", [False, True])
def test_every_measurement_has_a_form_of_its_settings(name: str, real: bool, tmp_path: Path) -> None:
    sections = form_of(name, real=real)
    fields = [one for section in sections for one in section.fields]
    assert len(fields) > 20
    assert len({one.place for one in fields}) == len(fields)
    assert settings_text(sections, {one.place: one.default for one in fields}) == ""
    for one in fields:  # whatever may be typed for a default is taken for one
        assert one.kind != "choice" or one.default in one.choices, one
    given = {"gyro.name": 'a "gyro" \\ 7', "site.latitude_deg": "31.5"}
    file = tmp_path / "own.toml"
    file.write_text(settings_text(sections, given), encoding="utf-8")
    assert set(tomllib.loads(file.read_text(encoding="utf-8"))) <= {"gyro", "site"}
    settings, wrong = checked(name, file)
    assert wrong == {}
    assert (settings.gyro.name, settings.site.latitude_deg) == (given["gyro.name"], 31.5)
    file.write_text(settings_text(sections, {"site.latitude_deg": "95"}), encoding="utf-8")
    settings, wrong = checked(name, file)
    assert settings is None
    assert "90" in wrong["site.latitude_deg"]


@pytest.mark.slow
def test_mistakes_stand_beside_their_fields_and_nothing_starts(panel: dict[str, str]) -> None:
    visitor = Visitor(panel["control"])
    page = visitor.post("/measure/measure", do="begin", **{"measurement.records": "-3", "gyro.name": "<i>x"})
    assert "Settings that are wrong: 1<" in page
    assert re.search(r'field wrong">\s*<label for="measurement.records"', page)
    assert "&lt;i&gt;x" in page and "<i>x" not in page
    checked_page = visitor.post("/measure/measure", do="check", **SHORT)
    assert "expected U95" in checked_page and "rates_over_lock_in = [8]" in checked_page
    assert "8 records at each rate, in lock-in rates: +8" in " ".join(checked_page.split())
    assert "Nothing is measured now" in visitor.get("/")
    visitor.ask("GET", "/language/zh")
    wrong = {"measurement.records": "-3", "site.latitude_deg": "95", "scope.probe": "7", "gyro.name": ""}
    page = visitor.post("/measure/measure", do="check", **wrong)
    told = re.findall(r'<p class="bad-word">(.*?)</p>', page)
    assert len(told) >= 3
    assert not any(re.search("[a-z]{4}", one.replace("auto", "")) for one in told), told
    visitor.ask("GET", "/language/en")


# ---- measuring


@pytest.mark.slow
def test_a_measurement_from_the_form_to_its_report(panel: dict[str, str], tmp_path: Path) -> None:
    visitor = Visitor(panel["control"])
    visitor.post("/measure/measure", do="begin", unit="SN <7>", operator="Ann", note="", **SHORT)
    job = visitor.where
    page = visitor.until(job, lambda text: 'class="result' in text)
    assert "SN &lt;7&gt;" in page and "deg/s" in page
    page = visitor.until(job, lambda text: "/report.html" in text)
    report = re.search(r'href="(/file/runs/[^"]*report.html)"', page)
    assert report is not None
    assert "Lock-in rate" in visitor.get(report[1])
    assert "sandbox" in visitor.headers["content-security-policy"]
    runs = visitor.get("/runs?q=sn")
    assert "Runs: 1<" in runs
    (folder,) = re.findall(r'name="run" value="([^"]*)"', runs)
    visitor.post("/runs/note", run=folder, note="good <b>", tag="a b")
    assert "good &lt;b&gt;" in visitor.get("/runs") and "a b" in visitor.text
    visitor.post("/runs/export", run=folder, file="out.csv")
    assert (tmp_path / "out.csv").is_file()
    visitor.post("/runs/export", run=folder, file="../out.csv")
    assert visitor.status == 400 and not (tmp_path.parent / "out.csv").exists()
    by_another = urlencode([("run", folder), ("run", "--by=Somebody"), ("note", "mine")])
    assert visitor.ask("POST", "/runs/note", by_another)[0] == 400
    assert visitor.get("/runs/trend.svg").lstrip().startswith("<?xml")
    visitor.post(f"/job/{job.partition('=')[2]}/repeat")
    assert visitor.where != job
    visitor.until(visitor.where, lambda text: 'class="result' in text)
    both = re.findall(r'name="run" value="([^"]*)"', visitor.until("/runs", lambda text: "Runs: 2<" in text))
    body = "&".join(f"run={one}" for one in both)
    assert "lock-in rate" in visitor.ask("POST", "/runs/compare", body)[2]


@pytest.mark.slow
def test_views_come_as_events_and_go_on_from_where_a_reader_was(panel: dict[str, str]) -> None:
    visitor = Visitor(panel["control"])
    visitor.post("/measure/measure", do="begin", **SHORT)
    name = visitor.where.partition("=")[2]
    told = visitor.events(f"/events?job={name}", 6)
    numbers = [number for number, _ in told]
    assert numbers == sorted(numbers)
    assert any(len(news.get("trace", {}).get("samples", ())) > 100 for _, news in told)
    visitor.until(visitor.where, lambda text: 'class="result' in text)
    ((last, news),) = visitor.events(
        f"/events?job={name}&after=3", 1
    )  # that counter is long gone: the state as it is
    assert last >= max(numbers)
    assert 'class="result' in str(news["view"]) and news["alive"] in (True, False)
    assert visitor.ask("GET", "/events?job=nonsense")[0] == 404


@pytest.mark.slow
def test_stop_and_go_on(panel: dict[str, str]) -> None:
    visitor = Visitor(panel["control"])
    visitor.post("/measure/measure", do="begin", **{**SHORT, "measurement.records": "400"})
    job = visitor.where
    visitor.until(job, lambda text: "records saved" in text)
    visitor.post(f"/job/{job.partition('=')[2]}/stop")
    page = visitor.until(job, lambda text: "ended with exit code" in text)
    assert "Go on with it" in page
    visitor.post(f"/job/{job.partition('=')[2]}/resume")
    visitor.until(visitor.where, lambda text: "records saved" in text)
    visitor.post(f"/job/{visitor.where.partition('=')[2]}/stop")
    visitor.until(visitor.where, lambda text: "ended with exit code" in text)
    assert "Runs: 1<" in visitor.get("/runs")
    # once more is a new run, also of one that was gone on with; a page that is no number is the first
    visitor.post(f"/job/{visitor.where.partition('=')[2]}/repeat")
    visitor.until(visitor.where, lambda text: "records saved" in text)
    visitor.post(f"/job/{visitor.where.partition('=')[2]}/stop")
    visitor.until("/runs?from=abc", lambda text: "Runs: 2<" in text)


@pytest.mark.slow
def test_a_killed_panel_costs_nothing_and_the_next_one_finds_the_measurement(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "station.cli", "panel", str(tmp_path), "--port", "0", "--json"],
        stdout=subprocess.PIPE, text=True, env=environment(tmp_path),
    )  # fmt: skip
    try:
        assert process.stdout is not None
        with process.stdout as said:
            visitor = Visitor(json.loads(said.readline())["control"])
        visitor.post("/measure/measure", do="begin", **{**SHORT, "measurement.records": "60"})
        job = visitor.where
        visitor.until(job, lambda text: "records saved" in text)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(20)
    with running_panel(tmp_path) as addresses:
        after = Visitor(addresses["control"])
        after.cookies.update(visitor.cookies)
        page = after.until(job, lambda text: 'class="result' in text)
        assert "deg/s" in page


@pytest.mark.slow
def test_a_question_is_answered_in_the_page(panel: dict[str, str], tmp_path: Path) -> None:
    small = write_campaign(tmp_path)
    campaign = small.read_text(encoding="utf-8").replace("reports = false", "reports = false\nask_for_unit = true")
    (tmp_path / "own.toml").write_text(campaign, encoding="utf-8")
    small.unlink()
    visitor = Visitor(panel["control"])
    assert 'value="own.toml"' in visitor.get("/station")
    visitor.post("/station", file="own.toml", unit="BAD", operator="Ann")
    page = visitor.until("/station", lambda text: "The program asks" in text)
    assert "connect it" in page
    visitor.ask("GET", "/language/zh")
    chinese = re.search(r"(?s)<pre>(.*?)</pre>", visitor.get("/station"))
    assert chinese is not None
    assert set(re.findall(r"[A-Za-z]{3,}", chinese[1])) <= {"RLG", "GPIB", "USB", "BAD", "Acceptance"}
    visitor.ask("GET", "/language/en")
    assert "still tested" in visitor.post("/station", file="own.toml", unit="RLG-001")
    name = re.search(r'data-job="([^"]*)"', page)
    assert name is not None
    visitor.post(f"/job/{name[1]}/answer", answer="")
    page = visitor.until("/station", lambda text: "verdict-full" in text, 120)
    assert 'data-verdict="FAIL"' in page
    visitor.post("/station/history", file="own.toml")
    assert "BAD" in visitor.text
    assert "nothing was asked" in visitor.post(f"/job/{name[1]}/answer", answer="x")
    visitor.post("/station", file="own.toml", unit="RLG-001")
    page = visitor.until("/station", lambda text: "The program asks" in text)
    name = re.search(r'data-job="([^"]*)"', page)
    assert name is not None
    visitor.post(f"/job/{name[1]}/stop")
    visitor.until("/station", lambda text: "It did not begin." in text)
    (tmp_path / "bad.toml").write_text(campaign.replace("[[step]]", "[[stop]]"), encoding="utf-8")
    visitor.post("/station", file="bad.toml", unit="RLG-003")
    page = visitor.until("/station", lambda text: "It did not begin." in text)
    assert "bad.toml" in page and "gyrolock: " in page


# ---- bad input


@pytest.mark.slow
def test_what_cannot_be_is_one_clear_line(tmp_path: Path) -> None:
    def told(*arguments: object) -> tuple[int, str]:
        command = [sys.executable, "-m", "station.cli", "panel", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        return done.returncode, done.stderr

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        code, said = told(tmp_path, "--port", other.getsockname()[1])
    assert code == 2 and "cannot be listened on" in said
    code, said = told(tmp_path / "nowhere")
    assert code == 2 and "no such folder" in said
    if os.geteuid() != 0:
        tmp_path.chmod(0o500)
        assert told(tmp_path)[0] == 5
