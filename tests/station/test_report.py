"""The report: one file, well-formed, with unique ids, and the numbers of the result in it."""

import xml.etree.ElementTree as ET
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from station.live.events import Progress
from station.lock_in.measurement import MEASUREMENT
from station.lock_in.messages import lock_in_words
from station.lock_in.report import line_svg, spectrum_svg, time_record_svg, values_svg
from station.lock_in.settings import load_settings
from station.report.figure import legend_above, make_room, svg_element
from station.report.show import render_report, write_report
from station.runs.store import SavedRun, open_run
from station.shell.finish import evaluate_run, start_run
from tests.ideal_bench import ideal_bench

VOID = {"meta", "br", "img", "link", "hr", "input"}


class Page(HTMLParser):
    """Collects ids, links and texts, and sees that every element is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.used: set[str] = set()
        self.addresses: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attributes:
            value = value or ""
            if name == "id":
                self.ids.append(value)
            if name in ("href", "src", "xlink:href"):
                (self.used.add(value[1:]) if value.startswith("#") else self.addresses.append(value))
            if "url(#" in value:
                self.used.add(value.split("url(#")[1].split(")")[0])

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> SavedRun:
    folder = tmp_path_factory.mktemp("report")
    (folder / "my.toml").write_text('[gyro]\nname = "<b>No. 7 & Söhne</b>"\n')
    overrides = ideal_bench(
        measurement={"rates_over_lock_in": [8.0], "records": 3}, output={"directory": str(folder)}
    )
    settings = load_settings(folder / "my.toml", overrides=overrides)
    taken = start_run(MEASUREMENT, settings, Progress())
    assert taken.failure is None
    return open_run(taken.path)


@pytest.mark.slow
def test_the_page_is_whole_and_stands_alone(run: SavedRun) -> None:
    page = Page()
    page.feed(render_report(evaluate_run(run)))
    page.close()
    assert page.open == []
    assert [name for name, count in Counter(page.ids).items() if count > 1] == []
    assert page.used <= set(page.ids)
    assert page.addresses == []


def test_the_page_shows_result_settings_and_provenance(run: SavedRun) -> None:
    evaluation = evaluate_run(run).found
    html = render_report(evaluate_run(run))
    page = Page()
    page.feed(html)
    for value in (*lock_in_words(evaluation), "deg/h", "95 % interval", "2000 pulses/deg", "TEKTRONIX,TDS 2014"):
        assert value in page.text
    for value in ("white noise", "seed", "numpy", "second harmonic", "tilt of the axis", run.facts["started_at"]):
        assert value in page.text
    assert "<b>No. 7" not in html
    assert "<b>No. 7 & Söhne</b>" in page.text
    assert "simulated bench" in page.text
    assert html.count("<svg") == 6
    assert "lock-in rate, combined" in page.text


@pytest.mark.slow
def test_the_same_run_gives_the_same_page(run: SavedRun) -> None:
    assert render_report(evaluate_run(run)) == render_report(evaluate_run(run))


def test_every_figure_is_well_formed_and_names_what_it_shows(run: SavedRun) -> None:
    evaluation = evaluate_run(run).found
    wave = evaluation.waveforms[0]
    figures = (
        time_record_svg(wave),
        spectrum_svg(wave),
        line_svg(wave, 1),
        line_svg(wave, 2),
        values_svg(evaluation),
    )
    for svg in figures:
        assert ET.fromstring(svg).tag.endswith("svg")
        assert len(svg) < 120_000
        assert "Date" not in svg
    assert ">2f<" in figures[1]
    assert "truth of the simulation" in figures[4] and "beat, Hz" in figures[4]


def test_the_file_appears_whole_beside_the_run(run: SavedRun, tmp_path: Path) -> None:
    path = write_report(evaluate_run(run))
    assert path == run.path.parent / "report.html"
    elsewhere = write_report(evaluate_run(run), tmp_path / "other.html")
    assert elsewhere.read_text(encoding="utf-8") == path.read_text(encoding="utf-8")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["other.html"]


def test_a_result_that_means_nothing_is_told_as_such(run: SavedRun) -> None:
    cut = SavedRun(run.path, run.facts, tuple(_silenced(record) for record in run.records), None)
    evaluation = evaluate_run(cut).found
    assert not evaluation.usable
    page = Page()
    page.feed(render_report(evaluate_run(cut)))
    assert "no lock-in rate" in page.text
    assert "All samples are equal" in page.text
    document = evaluate_run(cut).document()
    assert document["lock_in_rate_dps"] is None
    assert "constant" in document["flags"]


def _silenced(record):
    if record.purpose == "tilt":
        return record
    return record._replace(payload=bytes(len(record.payload)))


@pytest.mark.slow
def test_labels_have_room_and_a_name_without_end_stops_no_report() -> None:
    beyond: list[float] = []

    def draw(figure: Figure, name: str) -> None:
        for axes in figure.subplots(2, 2).ravel():
            axes.plot([1e-9, 2e-9], [1e6, 2e6], label=name)
            axes.set(xlabel="time, s", ylabel="rate, deg/s")
            legend_above(axes)

    def placed(figure: Figure) -> None:
        draw(figure, "fit")
        make_room(figure)
        whole, boxes = figure.bbox, [axes.get_tightbbox() for axes in figure.axes]
        beyond.extend(max(-b.x0, b.x1 - whole.width, -b.y0, b.y1 - whole.height) for b in boxes)
        beyond.extend(float(a.overlaps(b)) for n, a in enumerate(boxes) for b in boxes[:n])

    assert "<svg" in svg_element("room", (10.0, 4.6), placed)
    assert len(beyond) == 4 + 6 and max(beyond) < 0.5  # pixels
    assert "<svg" in svg_element("long", (5.0, 3.1), lambda figure: draw(figure, "name of a unit " * 30))
