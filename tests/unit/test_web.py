"""The page's server without a browser: what it lets in, what it hands on, what it says."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import socket
import ssl
import subprocess
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from urllib.parse import urlencode

import pytest

from dashboard.web import embedded, guard, relay
from dashboard.web import feed as feeds
from dashboard.web.app import BY_WORD
from dashboard.web.guard import Rules
from runtime import messages as m
from runtime.messages import Message, Reply
from runtime.topics import REQUESTS
from tests.unit.page_server import PATIENCE_S, Page, served


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


# ── whom it lets in ───────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("host", ["localhost", "localhost:9000", "127.0.0.1:8800", "[::1]:8800"])
def test_names_of_this_host(page: Page, host: str) -> None:
    assert page.get("/", Host=host).status == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8800", "192.168.7.7", "localhost.x"]
)
def test_a_name_that_somebody_else_has_given_us_is_refused(page: Page, host: str) -> None:
    answer = page.post("/api/request/estop", "{}", Host=host)
    assert answer.status == 421
    assert f"not served as '{host.partition(':')[0]}'" in answer.json["text"]
    assert page.asked == []


@pytest.mark.parametrize("host", ["robot.lab", "Robot.lab.:8800", "192.168.7.7:80"])
def test_a_refused_name_is_let_in_as_the_refusal_advises(tmp_path: Path, host: str) -> None:
    with served(tmp_path) as page:
        text = page.get("/", Host=host).json["text"]
    said = re.search(r"'(.+)'; .* add it to \[web\] names", text)
    assert said
    with served(tmp_path, names=(said[1],)) as page:
        assert page.get("/", Host=host).status == 200


def test_a_browser_asks_whether_what_it_keeps_is_still_right(page: Page) -> None:
    for path in ("/", "/results", "/static/page.js", "/static/style.css"):
        assert page.get(path).headers["Cache-Control"] == "no-cache", path


def test_another_pages_request_is_refused(page: Page) -> None:
    here = f"localhost:{page.port}"
    for origin in ("https://evil.example", f"https://{here}", "http://localhost:1", "null"):
        answer = page.post("/api/request/reset", "{}", Host=here, Origin=origin)
        assert answer.status == 403
        assert origin in answer.json["text"]
    assert page.asked == []
    answer = page.post("/api/request/reset", "{}", Host=here, Origin=f"http://{here}")
    assert answer.status == 200


def test_no_other_page_may_put_it_in_a_frame(page: Page) -> None:
    headers = page.get("/").headers
    assert headers["X-Frame-Options"] == "SAMEORIGIN"
    assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]


def test_names_beyond_loopback() -> None:
    rules = Rules("elbow", "t", names=("arm.lab",), anywhere=True)
    for name in ("10.0.0.7:8800", "[fe80::1]:8800", "arm.lab", "ARM.lab.", socket.gethostname()):
        assert rules.knows(name), name
    for name in ("evil.example", "arm.lab.evil.example", ""):
        assert not rules.knows(name), name


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with served(tmp_path_factory.mktemp("guarded"), address="0.0.0.0") as page:
        yield page


def token_of(page: Page) -> str:
    return page.place.rules.token


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "WRONG_S", 0.0)


def test_not_many_tokens_can_be_tried(guarded: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "WRONG_S", 0.1)
    form = {"Content_Type": "application/x-www-form-urlencoded"}
    for path, headers in (("/api/request/reset", {"Authorization": "Bearer x"}), ("/login", form)):
        began_s = time.monotonic()
        assert guarded.post(path, "token=x", **headers).status in (401, 403)
        assert time.monotonic() - began_s >= 0.1, path


@pytest.mark.parametrize(
    ("asked", "then"),
    [
        ("/results?a=b", "/results?a=b"),
        ("//evil.example/", "/evil.example/"),
        ("/\\evil.example", "/%5Cevil.example"),
        ("https://evil.example", "/https://evil.example"),
        ("/\t/evil.example", "/%09/evil.example"),
    ],
)
def test_a_token_that_is_typed_in_leads_to_what_was_asked_for(
    guarded: Page, asked: str, then: str
) -> None:
    login = f"/login?{urlencode({'then': asked})}"
    form = {"Content_Type": "application/x-www-form-urlencoded"}
    assert guarded.post(login, f"token={token_of(guarded)}", **form).headers["Location"] == then


def test_a_page_that_is_asked_for_is_kept_in_mind(guarded: Page) -> None:
    asked = guarded.get("/results?a=b&token=x", Accept="text/html").headers["Location"]
    assert asked == "/login?then=%2Fresults%3Fa%3Db"


def test_from_elsewhere_a_token_is_asked_for(guarded: Page) -> None:
    assert len(token_of(guarded)) >= 32
    for path in ("/api/state", "/api/stream", "/static/page.js", "/viewer/"):
        answer = guarded.get(path)
        assert answer.status == 401, path
        assert "token" in answer.json["text"]
    for wrong in ("Bearer nonsense", "Basic x", "Bearer", "Bearer é"):
        answer = guarded.post("/api/request/estop", "{}", Authorization=wrong)
        assert answer.status == 401
    assert guarded.asked == []
    answer = guarded.post("/api/request/estop", "{}", Authorization=f"Bearer {token_of(guarded)}")
    assert answer.status == 200


def test_a_browser_is_led_to_the_page_that_asks_for_it(guarded: Page) -> None:
    answer = guarded.get("/", Accept="text/html")
    assert (answer.status, answer.headers["Location"]) == (303, "/login?then=%2F")
    first = guarded.get("/login")
    assert first.status == 200
    assert b"alert" not in first.body
    assert guarded.get("/static/style.css").status == 200
    wrong = guarded.post("/login", "token=x", Content_Type="application/x-www-form-urlencoded")
    assert wrong.status == 403
    assert b'<p role="alert" class="problem">That is not the token of this robot.</p>' in wrong.body
    assert "Set-Cookie" not in wrong.headers
    right = guarded.post(
        "/login", f"token={token_of(guarded)}", Content_Type="application/x-www-form-urlencoded"
    )
    assert (right.status, right.headers["Location"]) == (303, "/")
    cookie = right.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert guarded.get("/", Cookie=cookie.partition(";")[0]).status == 200


def test_a_token_in_the_address_becomes_a_cookie(guarded: Page) -> None:
    answer = guarded.get(f"/results?a=b&token={token_of(guarded)}")
    assert (answer.status, answer.headers["Location"]) == (303, "/results?a=b")
    assert "myograft-elbow=" in answer.headers["Set-Cookie"]
    assert guarded.get("/?token=nonsense").status == 401
    stopped = guarded.post(f"/api/request/estop?token={token_of(guarded)}", "{}")
    assert stopped.json["ok"], "a script's request is done, not led elsewhere"


def test_what_is_asked_of_strangers_is_short(guarded: Page) -> None:
    answer = guarded.post(
        "/login", b"x" * 100_000, Content_Type="application/x-www-form-urlencoded"
    )
    assert answer.status == 413


@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes its certificate with openssl")
def test_over_tls(tmp_path: Path) -> None:
    certificate, key = tmp_path / "page.pem", tmp_path / "key.pem"
    words = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2"
    subprocess.run(
        [
            *("openssl", *words.split(), "-subj", "/CN=localhost"),
            *("-addext", "subjectAltName=DNS:localhost"),
            *("-out", str(certificate), "-keyout", str(key)),
        ],
        check=True,
        capture_output=True,
    )
    with served(tmp_path, certificate=str(certificate), key=str(key)) as page:
        assert page.place.url == f"https://localhost:{page.port}"
        trust = ssl.create_default_context(cafile=str(certificate))
        with urllib.request.urlopen(page.place.url, context=trust) as answer:
            assert answer.status == 200
        request = urllib.request.Request(
            f"{page.place.url}/api/request/reset",
            b"{}",
            {"Content-Type": "application/json", "Origin": page.place.url},
        )
        with urllib.request.urlopen(request, context=trust) as answer:
            assert json.load(answer)["ok"] is True


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
