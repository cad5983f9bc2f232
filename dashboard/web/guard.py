"""Who may speak to the page's server: the right name, the right page, the right token.

A page of somebody else that is open in the same browser must not move the robot. It could ask by
a name of its own that leads to this address (DNS rebinding): then the `Host` is not one of ours.
It could send a request across (CSRF): then the `Origin` is not this page. From other hosts a token
is asked for besides: as `Authorization: Bearer`, once as `?token=`, or typed in on a page.
"""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import socket
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import URL, Headers, MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

SAFE = ("GET", "HEAD")
OPEN = ("/login", "/static/style.css", "/static/icon.svg")  # what the page that asks for it needs
COOKIE_AGE_S = 30 * 24 * 3600
WRONG_S = 0.5  # before a wrong token is refused, so that not many can be tried

_HEADERS = {
    "Cache-Control": "no-cache",  # a page and its scripts are of one release
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "same-origin",  # without one a form's `Origin` is null
}
_POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; "
    "frame-ancestors 'self'"
)
# Rerun's viewer is WebAssembly with scripts and styles inside its page.
_VIEWER_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:; "
    "connect-src 'self' data: blob:; frame-ancestors 'self'"
)


@dataclass(frozen=True, slots=True)
class Rules:
    """Who is let in.

    Attributes:
        robot: names the cookie, for cookies do not tell ports apart.
        token: that is asked for; "" asks for none.
        names: host names by which we are known besides.
        anywhere: asked from other hosts too, by this host's own names and addresses; else by a
            loopback name only.
    """

    robot: str
    token: str = ""
    names: tuple[str, ...] = ()
    anywhere: bool = False

    @property
    def cookie(self) -> str:
        """The name of the cookie that holds the token."""
        return f"myograft-{self.robot}"

    def knows(self, host: str) -> bool:
        """Whether a `Host` is a name of ours. An address in digits is: nobody can rebind that."""
        name = _plain_name(host)
        if name in ("localhost", *map(_plain_name, self.names)):
            return True
        try:
            address = ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            here = socket.gethostname()
            return self.anywhere and name in (here.lower(), f"{here}.local".lower())
        return self.anywhere or address.is_loopback

    def fits(self, token: str | None) -> bool:
        """Whether a token is the one."""
        return secrets.compare_digest((token or "").encode(), self.token.encode())


class Guard:
    """Stands before an ASGI application, and puts the headers that a browser heeds on answers."""

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        self._app = app
        self._rules = rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or answer it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        policy = _VIEWER_POLICY if scope["path"].startswith("/viewer/") else _POLICY

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("Content-Security-Policy", policy)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        refusal = self._refusal(HTTPConnection(scope))
        if refusal is not None and refusal.status_code == 401:
            await asyncio.sleep(WRONG_S)
        await (refusal or self._app)(scope, receive, send_with_headers)

    def _refusal(self, request: HTTPConnection) -> Response | None:
        headers, rules = request.headers, self._rules
        host = headers.get("host", "")
        if not rules.knows(host):
            name = f"this page is not served as '{_plain_name(host)}'"
            advice = "if that is a name of its host, add it to [web] names in the robot file"
            return said(421, f"{name}; {advice}")
        if request.scope["method"] not in SAFE and not _same_origin(headers, request.url):
            text = f"a page of {headers.get('origin')} may not speak to this robot"
            return said(403, text)
        # Not `request.url`: that is made of the `Host`, which is the asker's to choose.
        if not rules.token or request.scope["path"] in OPEN:
            return None
        offered = request.query_params.get("token")
        if offered is not None and rules.fits(offered):
            return self._welcome(request) if request.scope["method"] in SAFE else None
        if rules.fits(_bearer(headers)) or rules.fits(request.cookies.get(rules.cookie)):
            return None
        if "text/html" in headers.get("accept", ""):
            return RedirectResponse(f"/login?{urlencode({'then': _where(request)})}", 303)
        return said(401, "this page asks for its token: Authorization: Bearer TOKEN")

    def _welcome(self, request: HTTPConnection) -> Response:
        """Put the token where the address line does not show it."""
        return with_cookie(RedirectResponse(_where(request), 303), request.url, self._rules)


def with_cookie(response: Response, url: URL, rules: Rules) -> Response:
    """Let the browser keep the token; no script can read it, no other site sends it."""
    response.set_cookie(
        rules.cookie,
        rules.token,
        max_age=COOKIE_AGE_S,
        httponly=True,
        samesite="strict",
        secure=url.scheme == "https",
    )
    return response


async def log_in(request: Request, body: bytes, rules: Rules) -> Response | None:
    """To the page that was asked for first, with a token that was typed in; None: a wrong one."""
    form = dict(parse_qsl(body.decode(errors="replace")))
    if not rules.fits(form.get("token", "").strip()):
        await asyncio.sleep(WRONG_S)
        return None
    path = "/" + request.query_params.get("then", "").lstrip("/")  # `//name` is another host
    return with_cookie(RedirectResponse(path, 303), request.url, rules)


def said(status: int, text: str) -> Response:
    """A refusal in one sentence, as every answer of this server has it."""
    return JSONResponse({"ok": False, "text": text}, status)


def _where(request: HTTPConnection) -> str:
    """What was asked for, but for the token."""
    query = [pair for pair in parse_qsl(request.url.query) if pair[0] != "token"]
    return request.url.path + (f"?{urlencode(query)}" if query else "")


def _same_origin(headers: Headers, url: URL) -> bool:
    """Browsers tell the origin of whatever changes something; other clients need not."""
    origin = headers.get("origin")
    return origin is None or origin == f"{url.scheme}://{headers['host']}"


def _bearer(headers: Headers) -> str:
    kind, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if kind.lower() == "bearer" else ""


def _plain_name(host: str) -> str:
    """Without port, capitals and the dot of a full name."""
    name = host.partition("]")[0] + "]" if host.startswith("[") else host.partition(":")[0]
    return name.lower().rstrip(".")
