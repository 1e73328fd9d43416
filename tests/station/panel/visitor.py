"""A panel of its own process, and visitors that speak HTTP with it."""

import http.client
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlencode, urlsplit


@contextmanager
def running_panel(folder: Path, *more: str) -> Iterator[dict[str, str]]:
    """`gyrolock panel` on a free port; its addresses."""
    process = subprocess.Popen(
        [sys.executable, "-m", "station.cli", "panel", str(folder), "--port", "0", "--json", *more],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment(folder),
    )  # fmt: skip
    try:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close()


def environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "GYROLOCK_STATE": str(folder / "state")}


class Visitor:
    """A browser without scripts: keeps cookies, follows to where it is sent."""

    def __init__(self, address: str) -> None:
        place = urlsplit(address)
        self.host, self.cookies = place.netloc, dict[str, str]()
        self.status, self.headers, self.text = self.ask("GET", f"/?{place.query}")

    def get(self, path: str) -> str:
        self.status, self.headers, self.text = self.ask("GET", path)
        return self.text

    def post(self, path: str, **fields: str) -> str:
        body = urlencode(fields)
        self.status, self.headers, self.text = self.ask("POST", path, body)
        if self.status == 303:
            self.where = self.headers["location"]
            return self.get(self.where)
        return self.text

    def ask(self, method: str, path: str, body: str = "", **headers: str) -> tuple[int, dict[str, str], str]:
        connection = http.client.HTTPConnection(self.host, timeout=60)
        cookies = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        sent = {"Cookie": cookies, **{name.replace("_", "-"): value for name, value in headers.items()}}
        if method == "POST":
            sent.setdefault("Content-Type", "application/x-www-form-urlencoded")
        try:
            connection.request(method, path, body or None, sent)
            answer = connection.getresponse()
            for name, value in answer.getheaders():
                if name.lower() == "set-cookie":
                    key, _, rest = value.partition("=")
                    self.cookies[key] = rest.partition(";")[0]
            found = {name.lower(): value for name, value in answer.getheaders()}
            return answer.status, found, answer.read().decode()
        finally:
            connection.close()

    def events(self, path: str, wanted: int, seconds: float = 30.0) -> list[tuple[int, dict[str, object]]]:
        """So many events of the server, with their ids."""
        connection = http.client.HTTPConnection(self.host, timeout=seconds)
        cookies = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        try:
            connection.request("GET", path, headers={"Cookie": cookies})
            answer, found, number = connection.getresponse(), [], -1
            assert answer.getheader("content-type", "").startswith("text/event-stream")
            while len(found) < wanted:
                line = answer.readline().decode().strip()
                if line.startswith("id: "):
                    number = int(line[4:])
                elif line.startswith("data: "):
                    found.append((number, json.loads(line[6:])))
            return found
        finally:
            connection.close()

    def until(self, path: str, holds: Callable[[str], object], seconds: float = 90.0) -> str:
        """Load a page again and again until something holds of it."""
        end = time.monotonic() + seconds
        while not holds(self.get(path)):
            assert time.monotonic() < end, self.text
            time.sleep(0.2)
        return self.text
