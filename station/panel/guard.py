"""Who may do what in the panel: a token in the address, the host that was meant, one who holds the control.

Every request is looked at before anything else is: the host, the token (in the address once, then in a cookie),
for what changes something its origin, its size, and the lease. The lease is held by one browser, by name, and ends
half a minute after the last sign of life of its page.
"""

from __future__ import annotations

import hmac
import json
import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection, cookie_parser
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

Role = Literal["control", "look"]

CLIENT = "gyrolock-client"
LEASE_S = 30.0
LARGEST_BODY = 64 * 1024  # bytes
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""What a page may load: its own files, and no script or style that stands in it."""

OF_FILES = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; sandbox allow-popups"
"""What a report may load: it has its style in it, and no script."""


@dataclass
class Lease:
    """Who holds the control."""

    client: str = ""
    name: str = ""
    until: float = 0.0
    asked_by: str = ""  # somebody else who would like to have it

    def holder(self) -> str:
        """The name of who holds it; empty if nobody does."""
        return self.name if self.client and time.monotonic() < self.until else ""

    def take(self, client: str, name: str) -> bool:
        """Take it or keep it; whether that is possible."""
        if self.holder() and client != self.client:
            return False
        if client != self.client:
            self.asked_by = ""
        self.client, self.name, self.until = client, name or self.name or client[:4], time.monotonic() + LEASE_S
        return True

    def give(self, client: str) -> None:
        """Give it away."""
        if client == self.client:
            self.client, self.until, self.asked_by = "", 0.0, ""


@dataclass
class PanelGuard:
    """Tokens, hosts and the lease of one panel."""

    hosts: frozenset[str]  # names by which it may be asked for, without the port
    tokens: Mapping[Role, str]
    cookie: str = "gyrolock"  # a name of its own for each panel of a host
    lease: Lease = field(default_factory=Lease)
    # puts the reason of a refusal into the language of who asks
    put: Callable[[str, HTTPConnection], str] = lambda why, asked: why

    def role_of(self, token: str) -> Role | None:
        """What a token allows."""
        roles: tuple[Role, ...] = ("control", "look")
        return next((one for one in roles if hmac.compare_digest(self.tokens[one].encode(), token.encode())), None)


def tokens_of(folder: Path) -> dict[Role, str]:
    """Return the tokens of a folder, new ones the first time: an address holds for the next panel too."""
    file = folder / "tokens.json"
    with suppress(OSError, ValueError, KeyError, TypeError):
        saved = json.loads(file.read_text(encoding="utf-8"))
        return {"control": str(saved["control"]), "look": str(saved["look"])}
    made: dict[Role, str] = {"control": secrets.token_urlsafe(18), "look": secrets.token_urlsafe(18)}
    folder.mkdir(parents=True, exist_ok=True)
    file.touch(mode=0o600)
    file.write_text(json.dumps(made), encoding="utf-8")
    return made


class GuardedApp:
    """The app behind its guard."""

    def __init__(self, app: ASGIApp, guard: PanelGuard) -> None:
        self._app, self._guard = app, guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it in one line."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        cookies = cookie_parser(headers.get("cookie", ""))
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        client = cookies.get(CLIENT, "") or secrets.token_urlsafe(9)
        role = self._guard.role_of(given) or self._guard.role_of(cookies.get(self._guard.cookie, ""))
        token = self._guard.tokens[role] if role else ""
        status, why = self._wrong(scope, headers, role)
        if why:
            said = self._guard.put(why, HTTPConnection(scope))
            await PlainTextResponse(f"{said}\n", status)(scope, receive, send)
            return
        scope["state"] = {**scope.get("state", {}), "role": role, "client": client}

        async def told(message: Message) -> None:
            if message["type"] == "http.response.start":
                kept = {name.lower() for name, _ in message["headers"]}
                added = [
                    (b"content-security-policy", POLICY.encode()),
                    (b"x-content-type-options", b"nosniff"),
                    (b"referrer-policy", b"same-origin"),
                    (b"cache-control", b"no-store"),
                ]
                added = [one for one in added if one[0] not in kept]
                for name, value in ((self._guard.cookie, token), (CLIENT, client)):
                    if cookies.get(name) != value:
                        cookie = f"{name}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age=31536000"
                        added.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message["headers"], *added]}
            await send(message)

        await self._app(scope, _bounded(receive), told)

    def _wrong(self, scope: Scope, headers: Headers, role: Role | None) -> tuple[int, str]:
        """Status and reason of a request that is refused; an empty reason of one that is not."""
        host = urlsplit(f"//{headers.get('host', '')}").hostname or ""
        if host not in self._guard.hosts:
            return 421, "this panel is not asked for by this name: use the address that `gyrolock panel` printed"
        if role is None:
            return (
                403,
                "the token of the address is missing or wrong: use the address that `gyrolock panel` printed",
            )
        if scope["method"] in ("GET", "HEAD"):
            return 200, ""
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != headers.get("host"):
            return 403, "this request comes from another page"
        if role != "control":
            return 403, "this address is for looking on only"
        if int(headers.get("content-length") or 0) > LARGEST_BODY:
            return 413, f"more than {LARGEST_BODY} bytes were sent"
        return 200, ""


def _bounded(receive: Receive) -> Receive:
    """A body that says nothing of its length, and is cut off where it is too long."""
    seen = 0

    async def take() -> dict[str, Any]:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > LARGEST_BODY:
            return {"type": "http.disconnect"}
        return dict(message)

    return take
