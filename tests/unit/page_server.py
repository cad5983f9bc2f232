"""The page's server on a loopback port, over a robot that answers what a test wants."""

from __future__ import annotations

import asyncio
import http.client
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from dashboard.web.app import make_app
from dashboard.web.feed import Feed
from dashboard.web.place import Place, take_place
from dashboard.web.process import make_server
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings, Web, load_robot

PATIENCE_S = 30.0


class Answer(NamedTuple):
    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


class Page:
    """A served page, and whoever speaks to it without a browser."""

    def __init__(self, place: Place, folders: tuple[Path, ...] = ()) -> None:
        self.place = place
        self.port: int = place.socket.getsockname()[1]
        self.asked: list[Message] = []
        self.answer: Callable[[Message], list[Reply]] = lambda message: [Reply(ok=True, text="so")]
        self.viewer_url = ""
        self.feed = Feed()
        self.loop = asyncio.new_event_loop()
        app = make_app(self.feed, self._ask, place.rules, lambda: self.viewer_url, folders)
        self._server = make_server(app, place)

    def _ask(self, message: Message) -> list[Reply]:
        self.asked.append(message)
        return self.answer(message)

    def run(self) -> None:
        self.loop.run_until_complete(self._server.serve([self.place.socket]))
        self.loop.run_until_complete(self.loop.shutdown_default_executor())
        self.loop.close()

    def stop(self) -> None:
        def over() -> None:
            self.feed.end()
            self._server.should_exit = True

        self.loop.call_soon_threadsafe(over)

    @property
    def connections(self) -> int:
        return len(self._server.server_state.connections)

    def publish(self, section: str, data: object) -> None:
        """As the process does, on the loop."""
        done = threading.Event()

        def put() -> None:
            self.feed.publish(section, msgspec.json.encode(data))
            done.set()

        self.loop.call_soon_threadsafe(put)
        assert done.wait(PATIENCE_S)

    def connect(self) -> http.client.HTTPConnection:
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)

    def get(self, path: str, **headers: str) -> Answer:
        return self.send("GET", path, None, headers)

    def post(self, path: str, body: bytes | str, **headers: str) -> Answer:
        return self.send("POST", path, body, {"Content-Type": "application/json", **headers})

    def send(
        self, method: str, path: str, body: bytes | str | None, headers: dict[str, str]
    ) -> Answer:
        connection = self.connect()
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, named)
        response = connection.getresponse()
        answer = Answer(response.status, response.headers, response.read())
        connection.close()
        return answer


@contextmanager
def served(folder: Path, *, folders: tuple[Path, ...] = (), **web: Any) -> Iterator[Page]:
    """A page of the elbow, with a table `[web]` of its own."""
    page = Page(take_place(elbow(**web), folder, folder / "state"), folders)
    thread = threading.Thread(target=page.run)
    thread.start()
    try:
        yield page
    finally:
        page.stop()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def elbow(**web: Any) -> RobotSettings:
    return msgspec.structs.replace(load_robot("elbow"), web=Web(**{"port": 18_800, **web}))


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("page")
    return folder


@pytest.fixture(scope="module")
def shared(home: Path) -> Iterator[Page]:
    with served(home) as page:
        yield page


@pytest.fixture
def page(shared: Page) -> Page:
    shared.asked.clear()
    shared.answer = lambda message: [Reply(ok=True, text="so", data={"process": "executive"})]
    shared.viewer_url = ""
    return shared
