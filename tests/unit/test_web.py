"""The page's server without a browser: what it hands on, and what it says."""

from __future__ import annotations

import json
import math
import os
import socket
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from dashboard.web import embedded, relay
from dashboard.web import feed as feeds
from dashboard.web.app import BY_WORD
from runtime import messages as m
from runtime.messages import Message, Reply
from runtime.topics import REQUESTS
from tests.unit.page_server import PATIENCE_S, Page, home, page, served, shared

__all__ = ["home", "page", "shared"]  # fixtures


# ── pages and files ───────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("path", ["/", "/results", "/login"])
def test_pages_hold_nothing_from_elsewhere(page: Page, path: str) -> None:
    answer = page.get(path)
    assert answer.status == 200
    assert answer.headers["Content-Type"].startswith("text/html")
    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
    assert "'unsafe" not in answer.headers["Content-Security-Policy"]
    assert b"http://" not in answer.body
    assert b"https://" not in answer.body
    for file in (b"/static/style.css", b"/static/icon.svg"):
        assert file in answer.body
        assert page.get(file.decode()).status == 200


@pytest.mark.parametrize("path", ["/", "/results"])
def test_pages_know_their_robot_before_anybody_speaks(page: Page, path: str) -> None:
    """It is named in the command that stops it when the page cannot."""
    assert b'<body data-robot="elbow">' in page.get(path).body


def test_what_is_not_there_is_a_sentence(page: Page) -> None:
    for path in ("/nowhere", "/static/../app.py", "/static/none.js"):
        answer = page.get(path)
        assert answer.status == 404
        assert answer.json["ok"] is False
    assert page.get(f"/viewer/{embedded.release()}/passwd").status == 404
    assert page.get("/viewer/0.1/index.html").status == 404


def test_the_viewer_lies_under_its_release(page: Page) -> None:
    answer = page.get("/viewer/?url=rerun%2Bhttp://localhost/proxy")
    where = f"/viewer/{embedded.release()}/index.html?url=rerun%2Bhttp://localhost/proxy"
    assert (answer.status, answer.headers["Location"]) == (307, where)


def test_state_is_one_object_for_a_script(page: Page) -> None:
    page.publish("executive", {"stage": "hold"})
    page.publish("readings", {"time_s": 1.5})
    assert page.get("/api/state").json == {
        "executive": {"stage": "hold"},
        "readings": {"time_s": 1.5},
    }


# ── requests ──────────────────────────────────────────────────────────────────────────────────

BODIES: dict[str, tuple[dict[str, object], Message]] = {
    "plug": ({"muscle": "biceps_3"}, m.Plug(muscle="biceps_3")),
    "unplug": ({"muscle": "biceps_3"}, m.Unplug(muscle="biceps_3")),
    "reach": (
        {"angle_rad": {"elbow": math.pi / 4}},
        m.Reach(angle_rad={"elbow": math.pi / 4}),
    ),
    "task": ({"name": "sweep"}, m.Task(name="sweep")),
    "estop": ({"reason": "a test"}, m.Estop(reason="a test")),
    "reset": ({}, m.Reset()),
    "relearn": ({"method": "iii", "n_new": 5}, m.Relearn(method="iii", n_new=5)),
    "schema": (
        {"action": "rollback", "version": 2},
        m.SchemaRequest(action="rollback", version=2),
    ),
    "identify": (
        {"chain": "arm", "module": "triceps"},
        m.Identify(chain="arm", module="triceps"),
    ),
    "fault": (
        {"kind": "rupture", "target": "triceps", "amount": 1.0},
        m.Fault(kind="rupture", target="triceps", amount=1.0),
    ),
}


def test_every_request_of_the_table_can_be_put() -> None:
    assert set(BODIES) == set(BY_WORD)
    assert len(BY_WORD) == len(REQUESTS)


@pytest.mark.parametrize("word", list(BODIES))
def test_a_request_arrives_as_its_message(page: Page, word: str) -> None:
    body, message = BODIES[word]
    answer = page.post(f"/api/request/{word}", json.dumps(body))
    assert answer.status == 200
    assert answer.json["ok"] is True
    assert answer.json["text"] == "so"
    assert page.asked == [message]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("", "Input data was truncated"),
        ("{", "Input data was truncated"),
        ("[]", "Expected `object`, got `array`"),
        ('{"angle_rad": {"elbow": "half"}}', "Expected `float`, got `str`"),
        ('{"angle_rad": {"elbow": NaN}}', "malformed"),
        ("{}", "missing required field `angle_rad`"),
        (b"\xff\xfe", "malformed"),
    ],
)
def test_bad_input_is_refused_in_words_and_goes_nowhere(
    page: Page, body: str | bytes, words: str
) -> None:
    answer = page.post("/api/request/reach", body)
    assert answer.status == 400
    assert answer.json["ok"] is False
    assert words in answer.json["text"]
    assert "'reach'" in answer.json["text"]
    assert page.asked == []


def test_no_such_request(page: Page) -> None:
    answer = page.post("/api/request/dance", "{}")
    assert answer.status == 404
    assert "knows no request 'dance', only plug, unplug" in answer.json["text"]
    assert page.get("/api/request/reset").status == 405


def test_what_is_not_json_or_too_long_is_refused(page: Page) -> None:
    answer = page.post("/api/request/reset", "{}", Content_Type="text/plain")
    assert answer.status == 415
    answer = page.post("/api/request/reset", b" " * 100_000)
    assert answer.status == 413
    assert page.asked == []


def test_a_refusal_is_told_as_one(page: Page) -> None:
    page.answer = lambda message: [Reply(ok=False, text="joint 'elbow' reaches -5 .. 130 deg")]
    answer = page.post("/api/request/reach", '{"angle_rad": {"elbow": 9}}')
    assert answer.status == 409
    assert answer.json["text"] == "joint 'elbow' reaches -5 .. 130 deg"


def test_nobody_answers(page: Page) -> None:
    page.answer = lambda message: []
    answer = page.post("/api/request/task", '{"name": "sweep"}')
    assert answer.status == 503
    assert "nobody answered 'task'" in answer.json["text"]


def test_several_who_answer_are_named_and_one_refusal_is_a_refusal(page: Page) -> None:
    page.answer = lambda message: [
        Reply(ok=True, text="chain left is stopping", data={"process": "driver-left"}),
        Reply(ok=False, data={"process": "driver-right"}),
    ]
    answer = page.post("/api/request/estop", "{}")
    assert answer.status == 409
    assert answer.json["text"] == "driver-left: chain left is stopping; driver-right: refused"


def test_a_stop_waits_for_nobody(page: Page) -> None:
    """However many requests wait for a robot that does not answer."""
    release = threading.Event()

    def answer(message: Message) -> list[Reply]:
        if not isinstance(message, m.Estop):
            release.wait(PATIENCE_S)
        return [Reply(ok=True, text="stopping")]

    page.answer = answer
    waiting = [
        threading.Thread(target=page.post, args=("/api/request/reset", "{}")) for _ in range(40)
    ]
    for thread in waiting:
        thread.start()
    try:
        come_to(lambda: len(page.asked), min(32, (os.cpu_count() or 1) + 4))  # as asyncio has it
        assert page.post("/api/request/estop", "{}").json["text"] == "stopping"
        assert not release.is_set()
    finally:
        release.set()
        for thread in waiting:
            thread.join()


# ── the stream ────────────────────────────────────────────────────────────────────────────────


class Ear:
    """Somebody who listens to the stream of events."""

    def __init__(self, page: Page) -> None:
        self._connection = page.connect()
        self._connection.request("GET", "/api/stream")
        self.response = self._connection.getresponse()

    def hear(self, section: str) -> object:
        """The next data of a section."""
        while (line := self.response.readline().decode()) != f"event: {section}\n":
            assert line, "the stream ended"
        return json.loads(self.response.readline().decode().removeprefix("data: "))

    def close(self) -> None:
        self.response.close()
        self._connection.close()


def come_to(look: Callable[[], int], count: int) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while look() != count:
        assert time.monotonic() < deadline_s, f"there are {look()}, not {count}"
        time.sleep(0.01)


def listeners(page: Page, count: int) -> None:
    come_to(lambda: len(page.feed.listeners), count)


def test_whoever_comes_gets_everything_and_then_what_changes(page: Page) -> None:
    page.publish("executive", {"stage": "hold"})
    early, late = Ear(page), Ear(page)
    assert early.response.headers["Content-Type"].startswith("text/event-stream")
    assert early.hear("executive") == late.hear("executive") == {"stage": "hold"}
    listeners(page, 2)
    page.publish("executive", {"stage": "hold"})  # the same: nobody is told
    page.publish("executive", {"stage": "move"})
    assert early.hear("executive") == late.hear("executive") == {"stage": "move"}
    early.close()
    listeners(page, 1)
    late.close()
    listeners(page, 0)


def test_a_slow_listener_gets_the_newest_of_each_section() -> None:
    feed = feeds.Feed()
    with feed.listen() as listener:
        for number in range(1000):
            feed.publish("readings", b"%d" % number)
            feed.publish("executive", b'"move"')
        assert set(listener._waiting.values()) == {
            b"event: readings\ndata: 999\n\n",
            b'event: executive\ndata: "move"\n\n',
        }


def test_a_listener_that_takes_nothing_is_dropped(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "PATIENCE_S", 0.2)
    asleep = socket.create_connection(("127.0.0.1", page.port))
    asleep.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    listeners(page, 1)
    for number in range(200):  # more than fits into the sockets between
        page.publish("readings", [number] * 20_000)
        if not page.feed.listeners:
            break
    listeners(page, 0)
    asleep.close()
    come_to(lambda: page.connections, 0)
    page.publish("readings", {})


def test_listeners_are_let_go_when_the_process_ends(tmp_path: Path) -> None:
    with served(tmp_path) as page:
        page.publish("executive", {"stage": "hold"})
        ear = Ear(page)
        ear.hear("executive")
    assert ear.response.read().strip() == b""
    ear.close()


# ── the viewer's stream ───────────────────────────────────────────────────────────────────────

CALL = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"


class Viz(BaseHTTPRequestHandler):
    """Stands where viz serves."""

    protocol_version = "HTTP/1.1"
    heard: tuple[str, dict[str, str], bytes]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        Viz.heard = (self.path, {k.lower(): v for k, v in self.headers.items()}, body)
        self.send_response(200)
        self.send_header("Content-Type", "application/grpc-web+proto")
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for part in (b"frames", b" and", b" trailers"):
            self.wfile.write(b"%x\r\n%b\r\n" % (len(part), part))
        self.wfile.write(b"0\r\n\r\n")

    def log_message(self, *_: object) -> None: ...


def test_a_viewers_call_is_handed_on_without_our_token(page: Page) -> None:
    with HTTPServer(("127.0.0.1", 0), Viz) as viz:
        viz.timeout = PATIENCE_S
        threading.Thread(target=viz.handle_request).start()
        page.viewer_url = f"rerun+http://127.0.0.1:{viz.server_port}/proxy"
        answer = page.post(
            CALL, b"\0ask", Content_Type="application/grpc-web+proto", Cookie="myograft-elbow=t"
        )
    assert (answer.status, answer.body) == (200, b"frames and trailers")
    assert answer.headers["Content-Type"] == "application/grpc-web+proto"
    path, headers, body = Viz.heard
    assert (path, body) == (CALL, b"\0ask")
    assert headers["content-type"] == "application/grpc-web+proto"
    assert "cookie" not in headers


def test_a_viewer_may_only_read(page: Page) -> None:
    for call in (CALL.replace("ReadMessages", "WriteMessages"), "/rerun.cloud.v1/X/ReadX"):
        assert page.post(call, b"").status == 404


def test_viz_that_does_not_answer_is_given_up(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "HEADERS_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        page.viewer_url = f"rerun+http://127.0.0.1:{deaf.getsockname()[1]}/proxy"
        answer = page.post(CALL, b"")
    assert answer.status == 502
    assert "does not answer within" in answer.json["text"]


def test_no_stream_is_a_sentence(page: Page) -> None:
    assert "no live view now" in page.post(CALL, b"").json["text"]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        page.viewer_url = f"rerun+http://127.0.0.1:{free.getsockname()[1]}/proxy"
    answer = page.post(CALL, b"")
    assert answer.status == 502
    assert "viz does not answer" in answer.json["text"]
