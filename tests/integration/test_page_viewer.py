"""Rerun's own viewer and stream, as the page hands them out."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="needs the extra myograft[view]")

from dashboard.viewer import LOOPBACK
from dashboard.web import embedded
from runtime.hubs import free_port
from tests.unit.page_server import PATIENCE_S, served

ANYTHING = b"\0\0\0\0\0"  # one gRPC frame with an empty message


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def test_its_files_come_out_of_the_wheel_and_ask_for_nothing_elsewhere(tmp_path: Path) -> None:
    with served(tmp_path) as page:
        at = f"/viewer/{embedded.release()}"
        html = page.get(f"{at}/index.html")
        assert html.status == 200
        assert b"re_viewer.js" in html.body
        assert b"fonts.g" not in html.body
        assert "connect-src 'self'" in html.headers["Content-Security-Policy"]
        wasm = page.get(f"{at}/re_viewer_bg.wasm")
        assert wasm.headers["Content-Type"] == "application/wasm"
        assert "immutable" in wasm.headers["Cache-Control"]
        assert wasm.body.startswith(b"\0asm")
        assert len(wasm.body) > 10_000_000
    folder = embedded.unpack()
    assert sorted(path.name for path in folder.iterdir()) == sorted(embedded.FILES)


def test_a_stream_of_rerun_goes_through(tmp_path: Path) -> None:
    import rerun as rr

    port = free_port()
    stream = rr.RecordingStream("myograft test")
    stream.set_sinks(rr.GrpcServerSink(LOOPBACK, port, server_memory_limit="16MiB"))
    stream.log("words", rr.TextLog("heard through the page"))
    stream.flush(timeout_sec=PATIENCE_S)
    with served(tmp_path) as page:
        page.viewer_url = f"rerun+http://{LOOPBACK}:{port}/proxy"
        connection = page.connect()
        connection.request(
            "POST",
            "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages",
            ANYTHING,
            {"Content-Type": "application/grpc-web+proto", "X-Grpc-Web": "1"},
        )
        answer = connection.getresponse()
        assert answer.status == 200
        assert answer.headers["Content-Type"].startswith("application/grpc-web")
        heard, deadline = b"", time.monotonic() + PATIENCE_S
        while b"myograft test" not in heard and time.monotonic() < deadline:
            heard += answer.read1(65536)
        assert b"myograft test" in heard
        answer.close()
        connection.close()
    stream.disconnect()
