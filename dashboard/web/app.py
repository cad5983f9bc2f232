"""The page's server: files, one stream of sections, one address for each of the robot's requests.

`GET /api/state` is everything as one object, `GET /api/stream` the same as it changes, and
`POST /api/request/NAME` puts a request of `runtime/topics.py`: its body is the message as JSON,
its answer `{ok, text, replies}` with what everybody who serves it said.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from dashboard.viewer import ViewerError
from dashboard.web import embedded, results
from dashboard.web.feed import EventStream, Feed
from dashboard.web.guard import Guard, Rules, log_in, said
from dashboard.web.relay import CALLS, Relay, RelayError
from runtime.messages import Estop, Message, Reply
from runtime.topics import REQUESTS

STATIC = Path(__file__).parent / "static"
LONGEST_BODY = 64 * 1024
WRONG_TOKEN = '<p role="alert" class="problem">That is not the token of this robot.</p>'
BY_WORD = {row.key.rsplit("/", 1)[-1]: row.message for row in REQUESTS}

Ask = Callable[[Message], list[Reply]]


def make_app(
    feed: Feed,
    ask: Ask,
    rules: Rules,
    viewer_url: Callable[[], str],
    results_folders: tuple[Path, ...] = (),
) -> Starlette:
    """The ASGI application.

    Args:
        feed: what is streamed.
        ask: puts a request to the robot and waits for the replies; called in a thread.
        rules: who is let in.
        viewer_url: where viz serves now, or "".
        results_folders: what the page of results shows.
    """
    unpacking = asyncio.Lock()
    urgent = ThreadPoolExecutor(2, "estop")  # a stop never waits for other requests' answers

    def page(name: str) -> Callable[[Request], Response]:
        text = (STATIC / name).read_text().replace("{robot}", rules.robot)
        return lambda _: HTMLResponse(text)

    async def state(_: Request) -> Response:
        body = {name: msgspec.Raw(data) for name, data in feed.newest.items()}
        return Response(msgspec.json.encode(body), media_type="application/json")

    async def stream(_: Request) -> Response:
        return EventStream(feed)

    async def request(request: Request) -> Response:
        word = request.path_params["word"]
        kind = BY_WORD.get(word)
        if kind is None:
            return said(404, f"the robot knows no request '{word}', only {', '.join(BY_WORD)}")
        if request.headers.get("content-type", "").partition(";")[0] != "application/json":
            return said(415, "send the request as JSON: Content-Type: application/json")
        try:
            message = msgspec.json.decode(await _body(request), type=kind)
        except msgspec.MsgspecError as error:
            return said(400, f"'{word}' cannot be read: {error}")
        pool = urgent if kind is Estop else None
        return _told(word, await asyncio.get_running_loop().run_in_executor(pool, ask, message))

    async def login(request: Request) -> Response:
        asked = request.method == "POST"
        if asked and (response := await log_in(request, await _body(request), rules)):
            return response
        problem = WRONG_TOKEN if asked else ""
        text = (STATIC / "login.html").read_text().replace("{problem}", problem)
        return HTMLResponse(text, 403 if asked else 200)

    async def viewer(request: Request) -> Response:
        name, release = request.path_params["name"], embedded.release()
        if request.path_params["release"] != release or name not in embedded.FILES:
            return said(404, f"the viewer here is of release {release}, and has no file '{name}'")
        try:
            async with unpacking:
                folder = await asyncio.to_thread(embedded.unpack)
        except (ViewerError, OSError) as error:
            return said(503, str(error))
        headers = {"Cache-Control": "private, max-age=31536000, immutable"}
        return FileResponse(folder / name, media_type=embedded.FILES[name], headers=headers)

    async def newest_viewer(request: Request) -> Response:
        """Under its release, so that a browser may keep its 43 MB."""
        where = f"/viewer/{embedded.release()}/index.html"
        return RedirectResponse(
            f"{where}?{request.url.query}", headers={"Cache-Control": "no-store"}
        )

    async def relay(request: Request) -> Response:
        path = request.scope["path"]
        if not CALLS.fullmatch(path):
            return said(404, "a viewer may read viz's stream, and nothing else")
        try:
            call = Relay(viewer_url())
            body = await _body(request)
            status, headers, rest = await call.ask(path, request.headers.raw, body)
        except RelayError as error:
            return said(502, str(error))
        answer = StreamingResponse(rest, status)
        kept = (b"content-type", b"grpc-status", b"grpc-message", b"grpc-encoding")
        answer.raw_headers = [(name, value) for name, value in headers if name in kept]
        return answer

    async def listing(_: Request) -> Response:
        found = await asyncio.to_thread(results.find, results_folders)
        return JSONResponse([{"name": x.name, "title": x.title} for x in found.values()])

    async def findings(request: Request) -> Response:
        found = await asyncio.to_thread(results.find, results_folders)
        one = found.get(request.path_params["name"])
        if one is None:
            return said(404, f"there are no results '{request.path_params['name']}'")
        return JSONResponse(await asyncio.to_thread(results.read, one))

    async def picture(request: Request) -> Response:
        found = await asyncio.to_thread(results.find, results_folders)
        one = found.get(request.path_params["name"])
        file = one.pictures.get(request.path_params["file"]) if one else None
        if file is None:
            return said(404, "there is no such picture")
        return FileResponse(file, headers={"Content-Security-Policy": "sandbox"})

    async def wrong(_: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return said(error.status_code, f"{error.detail}: see the page at /")

    return Starlette(
        routes=[
            Route("/", page("index.html")),
            Route("/results", page("results.html")),
            Route("/login", login, methods=["GET", "POST"]),
            Route("/api/state", state),
            Route("/api/stream", stream),
            Route("/api/request/{word}", request, methods=["POST"]),
            Route("/api/results", listing),
            Route("/api/results/{name}", findings),
            Route("/api/results/{name}/{file}", picture),
            Route("/viewer/", newest_viewer),
            Route("/viewer/{release}/{name}", viewer),
            Route("/rerun.{call:path}", relay, methods=["POST"]),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, rules=rules)],
        exception_handlers={HTTPException: wrong},
    )


async def _body(request: Request) -> bytes:
    parts = bytearray()
    async for part in request.stream():
        parts += part
        if len(parts) > LONGEST_BODY:
            raise HTTPException(413, f"more than {LONGEST_BODY} bytes")
    return bytes(parts)


def _told(word: str, replies: list[Reply]) -> Response:
    """What really happened, in the words of everybody who answered."""
    if not replies:
        text = f"nobody answered '{word}': its process is not running or not ready"
        return said(503, text)
    done = all(reply.ok for reply in replies)
    texts = [reply.text or ("done" if reply.ok else "refused") for reply in replies]
    if len(replies) > 1:
        named = zip(replies, texts, strict=True)
        texts = [f"{reply.data.get('process', '?')}: {text}" for reply, text in named]
    told = {
        "ok": done,
        "text": "; ".join(texts),
        "replies": [msgspec.structs.asdict(reply) for reply in replies],
    }
    return JSONResponse(told, 200 if done else 409)
