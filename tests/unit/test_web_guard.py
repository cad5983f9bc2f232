"""Whom the page's server lets in: hosts, other pages, tokens, TLS."""

from __future__ import annotations

import json
import re
import shutil
import socket
import ssl
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest

from dashboard.web import guard
from dashboard.web.guard import Rules
from tests.unit.page_server import Page, home, page, served, shared

__all__ = ["home", "page", "shared"]  # fixtures


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
