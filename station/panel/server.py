"""The pages of the panel, and what their buttons do: each does what a command does.

A page is made here in the language of its reader and works without a script. With one, what is shown of a running
measurement is made anew as its events come (server-sent events, whose ids are the counters of the events): who was
away gets how things stand, and goes on from there.
"""

from __future__ import annotations

import asyncio
import functools
import json
import re
import subprocess
import threading
import time
import tomllib
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args, get_origin
from urllib.parse import quote, unquote

from jinja2 import Environment, FileSystemLoader
from pydantic import BaseModel
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import QueryParams
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from station.campaign.journal import PAGE_FILE
from station.catalogue import RunFilter, chosen, list_runs, write_trend
from station.errors import SettingsError, StationError, UsageError, describe_failure, one_line
from station.live.status import running_programs
from station.measurements import MEASUREMENTS, Measurement, measurement
from station.panel.guard import OF_FILES, GuardedApp, PanelGuard
from station.panel.jobs import Job, Jobs, command_line, said_by
from station.plan import duration_words, predict
from station.results.quantity import UNITS
from station.runs.store import REPORT_FILE
from station.settings import load, model_at, shipped_settings

PAGE, NAME = Path(__file__).with_name("page"), "gyrolock-name"
LOOK_S = 0.1  # between two looks at what a measurement has told
_VIEW_S = 1.0  # between two views of one measurement, for all its readers: a voice that reads aloud keeps up
_KEEP_S = 15.0  # after so long without news a reader gets a line that says nothing
_RUNS_KEPT_S = 2.0  # for so long a list of runs holds
_ROWS = 100
_DEEPEST, _LONGEST = 20, 2_000  # lines within lines, and characters, that are put into a language
_SHOWN = {".html", ".jpg", ".png", ".svg", ".csv", ".json", ".xml", ".txt"}
_SEVERAL = re.compile(r"[;,\s]+")


@functools.cache
def words(language: str) -> dict[str, Any]:
    """Return the words of a language, and under ``said`` what the program asks."""
    found = dict(tomllib.loads((PAGE / f"{language}.toml").read_text(encoding="utf-8")))
    return found | {"said": {re.compile(pattern): text for pattern, text in found["said"].items()}}


def put(said: str | None, language: str) -> str:
    """Put what the program says into a language, line by line; what it has no words for stays as it is."""
    return "\n".join(_line_put(line, language) for line in (said or "").split("\n"))


def _line_put(line: str, language: str, within: int = 0) -> str:
    """A line, whose groups are lines themselves; an instrument may say one without end."""
    known = words(language)
    if isinstance(word := known.get(line), str) and line.isupper():
        return word
    for pattern, text in known["said"].items():
        if within < _DEEPEST and len(line) < _LONGEST and (found := pattern.fullmatch(line)):
            return str(text.format(*(_line_put(one, language, within + 1) for one in found.groups(""))))
    return line


@functools.cache
def languages() -> tuple[str, ...]:
    """Return the languages that there are words of; English first."""
    return tuple(sorted((path.stem for path in PAGE.glob("*.toml")), key=lambda one: (one != "en", one)))


@dataclass
class OpenPanel:
    """What all pages share."""

    root: Path
    guard: PanelGuard
    jobs: Jobs
    served: subprocess.Popen[str] | None = None  # the simulated oscilloscope for other programs
    served_as: str = ""
    runs_at: float = -1.0  # negative: they are to be looked for before they are shown
    runs: Sequence[Any] = ()
    views: dict[tuple[str, str], tuple[tuple[int, bool, str], float, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.pages = Environment(
            loader=FileSystemLoader(PAGE), autoescape=True, trim_blocks=True, lstrip_blocks=True
        )
        self.pages.filters["put"] = put
        self.pages.filters["named"] = lambda key: FormField(key, "", "", "text").name

    def inside(self, named: str) -> Path:
        """Return a path in the panel's folder; UsageError for one that is not, or would pass for an option."""
        path, parts = (self.root / named).resolve(), Path(named).parts
        if not path.is_relative_to(self.root.resolve()) or any(one.startswith((".", "-")) for one in parts):
            raise UsageError(f"{named}: is not in the folder of the panel")
        return path

    def listed(self) -> Sequence[Any]:
        """All runs of the folder, the newest first; after a while they are looked for anew meanwhile."""
        if self.runs_at < 0:
            self._look_for_runs()
        elif time.monotonic() - self.runs_at > _RUNS_KEPT_S:
            self.runs_at = time.monotonic()  # nobody else looks meanwhile
            threading.Thread(target=self._look_for_runs, name="runs", daemon=True).start()
        return self.runs

    def _look_for_runs(self) -> None:
        with suppress(StationError, OSError):
            self.runs = list(reversed(list_runs(self.root)))
        self.runs_at = time.monotonic()

    def _page_of(self, job: Job) -> str:
        """The record of a test, or the report of a run, from the panel's folder; empty where there is none."""
        run = Path(job.run or "-")
        for path in (run.parent.parent / PAGE_FILE, run / REPORT_FILE):
            with suppress(ValueError):
                if (self.root / path).is_file():
                    return (self.root / path).resolve().relative_to(self.root.resolve()).as_posix()
        return ""

    def _picture_of(self, job: Job) -> str:
        """The picture of a campaign, from the panel's folder, for its questions; empty where there is none."""
        if job.words[:1] == ["station"]:
            with suppress(OSError, ValueError, KeyError, TypeError, UsageError):
                file = self.inside(job.words[1])
                named = file.with_name(tomllib.loads(file.read_text(encoding="utf-8"))["campaign"]["picture"])
                shown = named.relative_to(self.root).as_posix()
                return shown if self.inside(shown).is_file() and named.suffix in (".png", ".svg", ".jpg") else ""
        return ""

    def view(self, job: Job, language: str) -> str:
        """How a measurement stands, as HTML; made at most once a second for all readers."""
        key, stands = (job.name, language), (job.counter, self.jobs.alive(job), job.question)
        made, now = self.views.get(key), time.monotonic()
        if made is None or (made[0] != stands and now - made[1] >= _VIEW_S):
            result: dict[str, Any] = {}
            if job.ended:
                with suppress(OSError, ValueError):
                    result = json.loads((job.folder / "result.json").read_text(encoding="utf-8"))
            text = self.pages.get_template("live.html.j2").render(
                w=words(language), job=job, s=job.situation, alive=stands[1], said=result,
                duration=duration_words, page=self._page_of(job), picture=self._picture_of(job),
                language=language,
            )  # fmt: skip
            made = self.views[key] = stands, now, text
        return made[2]


def create_app(panel: OpenPanel) -> GuardedApp:
    """Return the app."""
    actions: dict[str, Callable[[OpenPanel, Request, QueryParams], Response]] = {
        "/measure/{name}": _measure,
        "/station": _station,
        "/station/history": _history,
        "/job/{name}/{what}": _on_job,
        "/runs/{what}": _on_runs,
        "/bench/{what}": _on_bench,
        "/control/{what}": _control,
    }
    looks: dict[str, Callable[[OpenPanel, Request], Response]] = {
        "/": _now,
        "/measure": lambda panel, request: RedirectResponse("/measure/measure", 303),
        "/measure/{name}": _form,
        "/station": _station_page,
        "/runs": _runs_page,
        "/runs/trend.svg": _trend,
        "/bench": _bench_page,
        "/file/{path:path}": _file,
        "/language/{code}": _language,
    }
    routes = [
        Route("/events", functools.partial(_events, panel)),
        Mount("/static", StaticFiles(directory=PAGE)),
        *(Route(path, functools.partial(_answer, panel, page), methods=["GET"]) for path, page in looks.items()),
        *(Route(path, functools.partial(_act, panel, do), methods=["POST"]) for path, do in actions.items()),
    ]

    @asynccontextmanager
    async def lifetime(_: Starlette) -> AsyncIterator[None]:
        yield
        if panel.served is not None:
            panel.served.terminate()

    def nowhere(request: Request, error: Exception) -> Response:
        return _page(panel, request, "message", said=_words(request)["no_such_page"], status=404)

    panel.guard.put = lambda why, asked: put(why, _language_of(asked))
    app = Starlette(routes=routes, lifespan=lifetime, exception_handlers={404: nowhere, 405: nowhere})
    return GuardedApp(app, panel.guard)


async def _answer(panel: OpenPanel, page: Callable[[OpenPanel, Request], Response], request: Request) -> Response:
    """Show a page; what is wrong with what was asked for is one line of it."""
    try:
        return await run_in_threadpool(page, panel, request)
    except Exception as error:
        return _failed(panel, request, error)


async def _act(panel: OpenPanel, action: Callable[..., Response], request: Request) -> Response:
    """Do what a button says, if this browser holds the control or nobody does."""
    lease = panel.guard.lease
    try:
        form = QueryParams((await request.body()).decode("utf-8", "replace"))
        name = form.get("name", "").strip()[:60] or unquote(request.cookies.get(NAME, ""))
        if not request.url.path.startswith("/control/") and not lease.take(request.state.client, name):
            said = _words(request)["lease_gone"].format(lease.holder())
            return _page(panel, request, "message", said=said, status=409)
        answer = await run_in_threadpool(action, panel, request, form)
        if name:
            answer.set_cookie(NAME, quote(name), samesite="strict", max_age=31_536_000)
        return answer
    except ClientDisconnect:  # or it sends without an end: the connection is closed
        raise
    except Exception as error:
        return _failed(panel, request, error)


def _failed(panel: OpenPanel, request: Request, error: Exception) -> Response:
    """One line of what is wrong, in the reader's language."""
    failure = describe_failure(error)
    said = (
        failure.message if failure else f"{type(error).__name__}: {one_line(error)} (this is a defect of gyrolock)"
    )
    language = _language_of(request)
    return _page(panel, request, "message", said=put(said, language), status=400 if failure else 500)


def _words(request: Request) -> dict[str, str]:
    return words(_language_of(request))


def _language_of(asked: HTTPConnection) -> str:
    """What the reader chose, else what the browser would like."""
    wished = [asked.cookies.get("gyrolock-language", "")]
    wished += [one.partition(";")[0].strip()[:2] for one in asked.headers.get("accept-language", "").split(",")]
    return next((one for one in wished if one in languages()), "en")


def _page(panel: OpenPanel, request: Request, page: str, *, status: int = 200, **more: Any) -> Response:
    language, lease = _language_of(request), panel.guard.lease
    holds = bool(lease.holder()) and lease.client == request.state.client
    text = panel.pages.get_template("panel.html.j2").render(
        w=words(language), language=language, page=page, panel=panel, role=request.state.role, holds=holds,
        holder=lease.holder(), asked_by=lease.asked_by if holds else "",
        my_name=unquote(request.cookies.get(NAME, "")),
        languages=[(one, words(one)["language"]) for one in languages()], version=version("gyrolock"), **more,
    )  # fmt: skip
    return HTMLResponse(text, status)


# --------------------
# What is measured now, and its events


def _now(panel: OpenPanel, request: Request) -> Response:
    jobs = panel.jobs.all()
    named = request.query_params.get("job", "")
    job = next((one for one in jobs if one.name == named), None) or next(
        (one for one in jobs if panel.jobs.alive(one)), jobs[0] if jobs else None
    )
    started = {one.situation.program.get("pid") for one in jobs}
    others = [one for one in running_programs() if one.alive and one.pid not in started]
    view = panel.view(job, _language_of(request)) if job else ""
    return _page(
        panel, request, "now", job=job, view=view, others=others,
        jobs=[(one, panel.jobs.alive(one)) for one in jobs[:12]], alive=job is not None and panel.jobs.alive(job),
    )  # fmt: skip


async def _events(panel: OpenPanel, request: Request) -> Response:
    """Views and records of one measurement, from a counter on: what is gone is told as it stands now."""
    try:
        job = await run_in_threadpool(panel.jobs.job, request.query_params.get("job", ""))
    except UsageError as error:
        return Response(f"{error}\n", 404, media_type="text/plain")
    language = _language_of(request)

    async def told() -> AsyncIterator[str]:
        trace, before, spoke = None, ("", ("", "")), time.monotonic()
        yield "retry: 1000\n\n"
        while True:
            alive = await run_in_threadpool(_read, panel, job)
            control = panel.guard.lease.holder(), panel.guard.lease.asked_by
            view = panel.view(job, language)
            news: dict[str, Any] = {}
            if view != before[0]:
                news["view"] = view
            if (drawn := job.situation.value.get("trace")) and drawn is not trace:
                news["trace"], trace = {**drawn, "key": job.situation.value.get("key", "")}, drawn
            if control != before[1]:
                news["holder"], news["asked_by"] = control
            if news:
                news |= {"alive": alive, "question": job.question, "cut_short": job.cut_short}
                before, spoke = (view, control), time.monotonic()
                yield f"id: {job.counter}\ndata: {json.dumps(news)}\n\n"
            elif time.monotonic() - spoke > _KEEP_S:
                spoke = time.monotonic()
                yield ": \n\n"
            if not alive and job.ended and not news:
                await asyncio.sleep(1.0)
            await asyncio.sleep(LOOK_S)

    return StreamingResponse(told(), media_type="text/event-stream", headers={"x-accel-buffering": "no"})


def _read(panel: OpenPanel, job: Job) -> bool:
    """Take what a measurement has told meanwhile; whether it still runs."""
    if not job.ended:
        panel.jobs.read(job)
    return panel.jobs.alive(job)


def _on_job(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    job, what = panel.jobs.job(request.path_params["name"]), request.path_params["what"]
    if what == "stop":
        panel.jobs.stop(job)
    elif what == "answer":
        job.answer(str(form.get("answer", "")))
    elif what == "resume":
        job = panel.jobs.resume(job)
    elif what == "repeat":
        job = panel.jobs.repeat(job)
    else:
        raise UsageError(_words(request)["no_such_page"])
    return RedirectResponse(f"/?job={job.name}", 303)


def _run_said(panel: OpenPanel, given: Sequence[str]) -> str:
    """Run a command to its end and return what it said; UsageError where it failed."""
    code, said = said_by(given, panel.root)
    if code in (2, 3, 5, 70):
        raise UsageError(said.splitlines()[-1].removeprefix("gyrolock: ") if said else f"exit code {code}")
    return said


# --------------------
# Measure: a form of the settings


def _checked_text(name: str, text: str) -> tuple[Any, dict[str, str]]:
    """Settings of a text, or what is wrong by their places."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "settings.toml"
        file.write_text(text, encoding="utf-8")
        return checked(name, file)


def _form(panel: OpenPanel, request: Request, form: Mapping[str, Any] | None = None) -> Response:
    name = request.path_params["name"]
    kind = kind_of(name)
    given = {place: str(text) for place, text in (form or {}).items()}
    real = given.get("real", request.query_params.get("real", "")) == "1"
    sections = form_of(name, real=real)
    text = settings_text(sections, given)
    more: dict[str, Any] = {"mistakes": {}, "prediction": None}
    if form is not None:
        settings, wrong = _checked_text(name, text)
        places = [one.place for section in sections for one in section.fields]
        for place, said in wrong.items():
            field_of = max((one for one in places if place.startswith(one)), key=len, default="")
            more["mistakes"][field_of] = said if field_of else f"{place}: {said}".removeprefix(": ")
        if settings is not None:
            more["prediction"] = predict(name, settings.model_dump(mode="json"))
    return _page(
        panel, request, "measure", name=name, title=kind.title, kinds=measurements(), sections=sections,
        given=given, text=text, real=real, has_real=form_of(name, real=True) != form_of(name),
        duration=duration_words, **more,
    )  # fmt: skip


def _measure(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    name, given = request.path_params["name"], {place: str(text) for place, text in form.items()}
    kind = kind_of(name)
    sections = form_of(name, real=given.get("real") == "1")
    text = settings_text(sections, given)
    if given.get("do") != "begin" or _checked_text(name, text)[0] is None:
        return _form(panel, request, given)
    labels = [(f"--{one}", given.get(one, "").strip()) for one in ("unit", "operator", "note")]
    begun = [*kind.command.split()[1:], *(word for pair in labels if pair[1] for word in pair)]
    return RedirectResponse(f"/?job={panel.jobs.start(begun, text).name}", 303)


# --------------------
# Station: a unit against the limits of a campaign


def _station_page(panel: OpenPanel, request: Request) -> Response:
    files = []
    for path in sorted(panel.root.glob("*.toml")):
        with suppress(OSError, ValueError):
            if "[[step]]" in path.read_text(encoding="utf-8"):
                files.append(path.name)
    jobs = [one for one in panel.jobs.all() if one.words[:1] == ["station"]]
    job = jobs[0] if jobs else None
    view = panel.view(job, _language_of(request)) if job else ""
    return _page(
        panel, request, "station", files=files, file=request.query_params.get("file", files[0] if files else ""),
        job=job, view=view, alive=job is not None and panel.jobs.alive(job),
    )  # fmt: skip


def _station(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    file, unit = str(form.get("file", "")).strip(), str(form.get("unit", "")).strip()
    if not unit:
        return RedirectResponse("/station", 303)
    if not panel.inside(file).is_file():
        raise UsageError(f"{file}: there is no such campaign file")
    if any(panel.jobs.alive(one) for one in panel.jobs.all() if one.words[:1] == ["station"]):
        raise UsageError("a unit is still tested")
    operator = str(form.get("operator", "")).strip()
    panel.jobs.start(["station", file, "--unit", unit, *(["--operator", operator] if operator else [])])
    return RedirectResponse(f"/station?file={quote(file)}", 303)


def _history(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    """Show all tests of a campaign and their control charts: the page that `gyrolock history` writes."""
    file = panel.inside(form.get("file", ""))
    try:
        folder = tomllib.loads(file.read_text(encoding="utf-8")).get("output", {}).get("directory", "tests")
    except (OSError, ValueError, AttributeError):
        raise UsageError(f"{form.get('file', '')}: there is no such campaign file") from None
    _run_said(panel, ["history", str(panel.inside(folder))])
    return RedirectResponse(f"/file/{quote(folder)}/index.html", 303)


# --------------------
# Runs: which there are, remarks on them, two side by side, their numbers over time


def _found(panel: OpenPanel, request: Request) -> list[Any]:
    text = request.query_params.get("q", "").casefold().split()
    asked = request.query_params
    found = chosen(panel.listed(), RunFilter(verdict=asked.get("verdict", ""), since=asked.get("since", "")))

    def says(entry: Any) -> str:
        told = (entry.unit, entry.command, entry.operator, entry.note, entry.gyro, entry.run, *entry.tags)
        return " ".join(
            [*(one or "" for one in told), *(str(one.get("note", "")) for one in entry.remarks)]
        ).casefold()

    return [one for one in found if all(word in says(one) for word in text)] if text else found


def _runs_page(panel: OpenPanel, request: Request, said: str = "") -> Response:
    found, asked_from = _found(panel, request), request.query_params.get("from", "0")
    first = int(asked_from) if asked_from.isdecimal() else 0
    rows = []
    for one in found[first : first + _ROWS]:
        folder = Path(one.run).parent.relative_to(panel.root).as_posix()
        rows.append((one, folder, (panel.root / folder / REPORT_FILE).is_file()))
    asked = {name: request.query_params.get(name, "") for name in ("q", "verdict", "since")}
    return _page(
        panel, request, "runs", rows=rows, count=len(found), first=first, rows_a_page=_ROWS, asked=asked, said=said
    )


def _trend(panel: OpenPanel, request: Request) -> Response:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "trend.svg"
        write_trend(file, list(reversed(_found(panel, request))))
        return Response(
            file.read_bytes(), media_type="image/svg+xml", headers={"content-security-policy": OF_FILES}
        )


def _on_runs(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    what, runs = request.path_params["what"], [str(one) for one in form.getlist("run")]
    for one in runs:
        panel.inside(one)
    if not runs:
        return RedirectResponse("/runs", 303)
    said = ""
    if what == "note":
        note = str(form.get("note", "")).strip()
        tags = [part for tag in _SEVERAL.split(str(form.get("tag", ""))) if tag for part in ("--tag", tag)]
        _run_said(panel, ["annotate", *runs, *(["--note", note] if note else []), *tags])
    elif what == "compare":
        said = _run_said(panel, ["compare", *runs[:2]])
    elif what == "export":
        file = str(form.get("file", "")).strip()
        panel.inside(file)
        said = _run_said(panel, ["export", *runs, "--to", file])
    elif what == "report":
        _run_said(panel, ["report", *runs])
    else:
        raise UsageError(_words(request)["no_such_page"])
    panel.runs_at = -1.0
    return _runs_page(panel, request, said) if said else RedirectResponse("/runs", 303)


def _file(panel: OpenPanel, request: Request) -> Response:
    """A report or another file of the folder, without scripts."""
    path = panel.inside(request.path_params["path"])
    if path.suffix not in _SHOWN or not path.is_file():
        raise UsageError(_words(request)["no_such_page"])
    return FileResponse(path, headers={"content-security-policy": OF_FILES})


# --------------------
# Bench: instruments, the installation, the screen, the simulated oscilloscope


def _bench_page(panel: OpenPanel, request: Request, said: str = "", picture: str = "") -> Response:
    if panel.served is not None and panel.served.poll() is not None:
        panel.served, panel.served_as = None, ""
    return _page(panel, request, "bench", said=said, picture=picture, served_as=panel.served_as)


def _on_bench(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    what, resource = request.path_params["what"], str(form.get("resource", "")).strip()
    if what in ("list", "doctor"):
        return _bench_page(panel, request, said_by([what], panel.root)[1])
    if what == "grab":
        folder = f"screens/{time.strftime('%Y-%m-%dT%H%M%S', time.gmtime())}"
        given = ["grab", *(["--resource", resource] if resource else []), "--to", folder]
        said = _run_said(panel, given)
        picture = next((panel.root / folder).rglob("*.png"), None) if (panel.root / folder).is_dir() else None
        shown = picture.relative_to(panel.root).as_posix() if picture else ""
        return _bench_page(panel, request, said, shown)
    if what == "serve" and panel.served is None:
        panel.served = subprocess.Popen(
            command_line(["simulate", "--tcp", "0"]), cwd=panel.root, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        panel.served_as = panel.served.stdout.readline().strip() if panel.served.stdout else ""
    elif what == "end" and panel.served is not None:
        panel.served.terminate()
        panel.served.wait(10)
    return RedirectResponse("/bench", 303)


# --------------------
# Who holds the control, and in which language it is read


def _control(panel: OpenPanel, request: Request, form: QueryParams) -> Response:
    lease, what, client = panel.guard.lease, request.path_params["what"], request.state.client
    name = (form.get("name", "").strip() or unquote(request.cookies.get(NAME, "")) or client[:4])[:60]
    if what == "take":
        lease.take(client, name)
    elif what == "keep":
        if lease.holder() and lease.client == client:
            lease.take(client, "")
        return Response(status_code=204)
    elif what == "give":
        lease.give(client)
    elif what == "ask":
        lease.asked_by = name
    back = request.headers.get("referer", "/")
    return RedirectResponse(back if back.startswith(str(request.base_url)) else "/", 303)


def _language(panel: OpenPanel, request: Request) -> Response:
    code = request.path_params["code"]
    back = request.headers.get("referer", "/")
    answer = RedirectResponse(back if back.startswith(str(request.base_url)) else "/", 303)
    if code in languages():
        answer.set_cookie("gyrolock-language", code, samesite="strict", max_age=31_536_000)
    return answer


def address(host: str, port: int, token: str) -> str:
    """Return the address of the panel."""
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/?token={token}"


# --------------------
# A form of a measurement's settings: fields, defaults and help from its shipped file, choices from its model.
#
# Nothing here knows a measurement: what the registry lists has a form


Kind = Literal["text", "switch", "choice", "list"]

REAL: dict[str, dict[str, object]] = {"scope": {"resource": "?"}, "link": {"port": "?"}}
"""What a user names who has a real bench."""

_SECTION = re.compile(r"\[([\w.]+)\]\s*$")
_SETTING = re.compile(r"(# )?(\w+) = (.*?)(?:\s+#\s*(.*))?$")
_MISTAKE = re.compile(r"([a-z_]+(?:\.\w+)+)(?: \(line \d+\))?: ")


@dataclass(frozen=True)
class FormField:
    """One setting."""

    place: str  # "measurement.records"
    default: str  # as it is typed; empty where the file leaves it out
    help: str
    kind: Kind
    choices: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Its name as a person reads it, without its unit."""
        name = self.place.rpartition(".")[2]
        stem = name.removesuffix(f"_{self._unit}") if self._unit else name
        return stem.replace("_", " ").replace("lock in", "lock-in")

    @property
    def unit(self) -> str:
        """Its unit, by the end of its name."""
        return UNITS.get(self._unit, "")

    @property
    def _unit(self) -> str:
        name = self.place.rpartition(".")[2]
        return max((one for one in UNITS if name.endswith(f"_{one}")), key=len, default="")


@dataclass(frozen=True)
class FormSection:
    """Settings that stand together."""

    name: str
    fields: tuple[FormField, ...]


def measurements() -> dict[str, str]:
    """Return what can be measured: name and title."""
    return {name: measurement(name).title for name in MEASUREMENTS if name != "program"}


def kind_of(name: str) -> Measurement[Any, Any]:
    """Return a measurement by its name; UsageError if there is none."""
    if name not in measurements():
        raise UsageError(f"there is no measurement {name!r}")
    return measurement(name)


def form_of(name: str, *, real: bool = False) -> list[FormSection]:
    """Return the sections that a measurement has, its own first."""
    kind = kind_of(name).kind
    file = shipped_settings(kind.shipped(REAL if real else {}))
    found: dict[str, dict[str, FormField]] = {}
    for section, one in _fields(file, kind.model):
        before = found.setdefault(section, {}).get(one.place)
        if before is None or one.default:  # in comments a setting may stand as an example
            found[section][one.place] = one
    # of settings that several measurements share, the sections of the others are of no use
    others = {one for one in MEASUREMENTS if measurement(one).kind is kind and one not in (name, "table")}
    sections = [FormSection(one, tuple(fields.values())) for one, fields in found.items() if one not in others]
    return sorted(sections, key=lambda one: one.name != name)


def _fields(file: Path, model: type[BaseModel]) -> Iterator[tuple[str, FormField]]:
    section, said = "", list[str]()
    for line in file.read_text(encoding="utf-8").splitlines():
        if found := _SECTION.match(line):
            section, said = found[1], []
        elif (found := _SETTING.match(line)) and section:
            commented, key, value, behind = found.groups()
            if (one := _field(section, key, value, model, stated=not commented)) is not None:
                helped = " ".join([*said, behind or ""]).strip()
                yield section, FormField(one.place, one.default, helped, one.kind, one.choices)
                said = []
            elif commented:
                said.append(line.removeprefix("# "))
        elif line.startswith("# "):
            said.append(line.removeprefix("# "))
        else:
            said = []


def _field(section: str, key: str, text: str, model: type[BaseModel], *, stated: bool) -> FormField | None:
    """A field of the model, by what the file has behind its name; ``None`` if there is none."""
    inside = model_at(model, section.split("."))
    if inside is None or key not in inside.model_fields:
        return None
    try:
        value = tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        return None
    annotation = inside.model_fields[key].annotation
    choices = tuple(map(str, _literals(annotation)))
    if choices and re.search(r"\bbool\b", str(annotation)):
        choices += ("true", "false")
    kind: Kind = "switch" if isinstance(value, bool) else "text"
    if isinstance(value, list) or re.search(r"(list|tuple)\[", str(annotation)):
        kind = "list"
    elif choices and not isinstance(value, bool) and not re.search(r"\b(int|float|str)\b", str(annotation)):
        kind = "choice"
    return FormField(f"{section}.{key}", _typed(value) if stated else "", "", kind, choices)


def _literals(annotation: Any) -> Iterator[object]:
    if get_origin(annotation) is Literal:
        yield from get_args(annotation)
    else:
        for part in get_args(annotation):
            yield from _literals(part)


def _typed(value: object) -> str:
    """A value as a person types it."""
    if isinstance(value, list):
        return ", ".join(map(_typed, value))
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)


def settings_text(sections: list[FormSection], given: Mapping[str, str]) -> str:
    """Return what differs from the defaults as TOML."""
    lines: list[str] = []
    for section in sections:
        changed = [
            (one, given[one.place].strip())
            for one in section.fields
            if one.place in given and given[one.place].strip() != one.default
        ]
        if changed:
            lines += ["", f"[{section.name}]"]
            lines += [f"{one.place.rpartition('.')[2]} = {_literal(one, text)}" for one, text in changed]
    return "\n".join(lines[1:]) + "\n" if lines else ""


def _literal(field: FormField, text: str) -> str:
    if field.kind == "list" and text not in field.choices:
        return f"[{', '.join(_scalar(one.strip()) for one in text.strip('[]').split(',') if one.strip())}]"
    return text if field.kind != "text" and text in ("true", "false") else _scalar(text)


def _scalar(text: str) -> str:
    """A number as it is, anything else as a text."""
    try:
        float(text)
    except ValueError:
        quoted = text.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{quoted}"'
    return text


def checked(name: str, file: Path) -> tuple[Any, dict[str, str]]:
    """Return the settings of a file, or what is wrong by the places of its settings; "" is none of them."""
    try:
        return load(kind_of(name).kind, file), {}
    except SettingsError as error:
        said = str(error).removeprefix(f"{file}: ")
        parts = _MISTAKE.split(said)
        found = {place: text.strip("; ") for place, text in zip(parts[1::2], parts[2::2], strict=True)}
        return None, found or {"": said}
