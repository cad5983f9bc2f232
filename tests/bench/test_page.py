"""Budgets of the page: how soon it is there, how old what it shows is, what it costs the robot."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest

from runtime import messages as m
from runtime.bus import Bus
from runtime.clock import RobotClock
from runtime.hubs import address_file
from tests.bench.timing import tell, tell_p99
from tests.e2e.conftest import PATIENCE_S, Command, Robot, elbow, home, running
from tests.e2e.test_page import CHROMIUM, FLAGS

pytest.importorskip("playwright.sync_api", reason="needs the extra myograft[dev]")
from playwright.sync_api import Browser, Page, expect, sync_playwright

__all__ = ["home"]  # a fixture: a registry of this module's own
pytestmark = pytest.mark.skipif(not CHROMIUM, reason="needs a browser: apt-get install chromium")

READY_S = 3.0
STARTS = 7
EVENT_S = 0.5  # p95
EVENTS = 40
LISTENERS = 10
ROUNDS = 20  # of each: short ones that alternate, as the machine's own noise comes in minutes
ROUND_S = 2.5
CPU_PERCENT = 6.0
GROUP_MB = 600.0

WHEN_READY = """
    document.addEventListener("DOMContentLoaded", () => {
        const [stage, controls] = ["stage", "controls"].map((id) => document.getElementById(id));
        const look = () => {
            if (stage.textContent === "hold" && !controls.disabled) window.readyAt ??= Date.now();
        };
        const changes = {attributes: true, childList: true, subtree: true};
        for (const each of [stage, controls]) new MutationObserver(look).observe(each, changes);
    });
"""

LISTEN = """
import selectors, socket, sys
port, ears = int(sys.argv[1]), []
with selectors.DefaultSelector() as awake:
    awake.register(sys.stdin, selectors.EVENT_READ)
    while True:
        for key, _ in awake.select():
            if key.fileobj is not sys.stdin:
                if not key.fileobj.recv(1 << 20):
                    awake.unregister(key.fileobj)
                continue
            for ear in ears:
                if ear.fileno() in awake.get_map():
                    awake.unregister(ear)
                ear.close()
            ears = [socket.create_connection(("127.0.0.1", port)) for _ in range(int(input()))]
            for ear in ears:
                ear.sendall(b"GET /api/stream HTTP/1.1\\r\\nHost: localhost\\r\\n\\r\\n")
                awake.register(ear, selectors.EVENT_READ)
            print("listening", flush=True)
            break  # what else was awake may be closed by now
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield browser
        browser.close()


def test_controls_are_ready_soon(browser: Browser, tmp_path: Path) -> None:
    """From the command to a page whose robot holds and can be asked; the browser is open.

    Each start is a new robot's. The page itself says when, as it is looked at only now and then.
    """
    announced_s, ready_s = [], []
    for start in range(STARTS):
        page = browser.new_page()
        page.add_init_script(WHEN_READY)
        file = elbow(tmp_path, f"soon{start}").file
        began_s = time.time()
        up = Command("up", file)
        try:
            page.goto(_announced(up))
            announced_s.append(time.time() - began_s)
            expect(page.get_by_role("button", name="Go there")).to_be_enabled()
            page.wait_for_function("() => window.readyAt", timeout=1e3 * PATIENCE_S)
            ready_s.append(page.evaluate("window.readyAt") / 1e3 - began_s)
        finally:
            page.close()
            up.end()
    print()
    for what, taken_s in (("page there", announced_s), ("controls ready", ready_s)):
        tell(f"command to {what}, p50", float(np.median(taken_s)), READY_S, "s")
        tell(f"command to {what}, worst of {STARTS}", max(taken_s), READY_S, "s")


def _announced(up: Command) -> str:
    up.wait_line("web ready")
    (line,) = (line for line in up.lines if "web ready" in line)
    found = re.search(r"http://\S+", line)
    assert found, line
    return found[0]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("watched")
    with running(elbow(folder, "watched"), folder) as robot:
        robot.ask(m.Task(name="sweep"))
        yield robot


def test_an_event_is_on_the_page_soon(browser: Browser, robot: Robot) -> None:
    page = browser.new_page()
    page.goto(address_file(robot.group.run_dir, "web").read_text())
    expect(page.locator("#stage")).not_to_have_text("connecting", timeout=30_000)
    page.evaluate(
        "window.seen = {}; new MutationObserver(() => {"
        "  for (const item of document.querySelectorAll('#events li')) {"
        "    const found = item.textContent.match(/event (\\d+) of/);"
        "    if (found) window.seen[found[1]] ??= Date.now();"
        "  }}).observe(document.getElementById('events'), {childList: true})"
    )
    late_s = _publish(page, robot)
    print()
    tell("event to page, p50", float(np.percentile(late_s, 50)), EVENT_S, "s")
    tell("event to page, p95", float(np.percentile(late_s, 95)), EVENT_S, "s")
    page.close()


def _publish(page: Page, robot: Robot) -> list[float]:
    sent_ms = []
    rng = np.random.default_rng(0)
    with Bus("watched", "bench", endpoint=robot.group.endpoint) as bus:
        for number in range(EVENTS):
            text = f"event {number} of {EVENTS}"
            sent_ms.append(1e3 * time.time())
            bus.publish(m.Event(process="bench", level="info", kind="bench", text=text))
            page.wait_for_timeout(float(rng.uniform(50, 250)))  # at any phase of the server's pace
        expect(page.locator("#events")).to_contain_text(f"event {EVENTS - 1} of", timeout=10_000)
    seen_ms = page.evaluate("window.seen")
    return [(seen_ms[str(i)] - sent) / 1e3 for i, sent in enumerate(sent_ms)]


@pytest.mark.timeout(300)
def test_ten_listeners_cost_the_robot_nothing(robot: Robot) -> None:
    web = psutil.Process(robot.pid("web"))
    ages_ms: dict[int, list[list[float]]] = {0: [], LISTENERS: []}
    cpu: dict[int, list[float]] = {0: [], LISTENERS: []}
    with (
        Bus("watched", "bench", endpoint=robot.group.endpoint) as bus,
        _listening(robot) as listen,
    ):
        bus.subscribe(m.ChainState, m.Clock, every=True)
        for round_ in range(ROUNDS):
            for count in sorted(ages_ms, reverse=round_ % 2 == 1):
                listen(count)
                web.cpu_percent()
                ages_ms[count].append(_ages_ms(bus, ROUND_S))
                cpu[count].append(web.cpu_percent())
    print("\nchain state's age")
    tell_p99("no listener", ages_ms[0], ages_ms[0])
    tell_p99("ten listeners", ages_ms[0], ages_ms[LISTENERS])
    even, odd = ages_ms[0][::2], ages_ms[0][1::2]
    tell_p99("no listener, odd over even", even, odd)  # what the measure makes of nothing
    tell("CPU of web, no listener", float(np.median(cpu[0])), CPU_PERCENT, "%")
    tell("CPU of web, ten listeners", float(np.median(cpu[LISTENERS])), CPU_PERCENT, "%")


@contextmanager
def _listening(robot: Robot) -> Iterator[Callable[[int], None]]:
    """Lets so many listen from now on, in a process of their own."""
    port = address_file(robot.group.run_dir, "web").read_text().rpartition(":")[2]
    command, pipe = [sys.executable, "-c", LISTEN, port], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as ears:
        assert ears.stdin is not None
        assert ears.stdout is not None
        say, heard = ears.stdin, ears.stdout

        def listen(count: int) -> None:
            say.write(f"{count}\n")
            say.flush()
            assert heard.readline() == "listening\n"

        yield listen
        ears.kill()


def _ages_ms(bus: Bus, seconds: float) -> list[float]:
    """How old chain states are, in robot time, when a reader has them."""
    clock, ages = RobotClock(), []
    bus.wait(0.0)
    over = time.monotonic() + seconds
    while time.monotonic() < over:
        for item in bus.wait(0.1):
            wall_ns = time.monotonic_ns()
            if isinstance(item, m.Clock):
                clock.update(item, wall_ns)
            elif isinstance(item, m.ChainState) and (now_ns := clock.now(wall_ns)) is not None:
                ages.append((now_ns - item.stamp_ns) / 1e6)
    assert len(ages) > 20 * seconds
    return ages


def test_memory(robot: Robot) -> None:
    """Pages that several processes share count once, in parts (PSS)."""
    rows = {row.process: row.pid for row in robot.group.rows}
    used_mb = {name: psutil.Process(pid).memory_full_info().pss / 1e6 for name, pid in rows.items()}
    print()
    for name, mb in used_mb.items():
        print(f"{name:<12} {mb:6.1f} MB")
    used_mb.pop("viz", None)
    tell("memory of web", used_mb["web"], 60.0, "MB")
    tell("memory of the group without viz", sum(used_mb.values()), GROUP_MB, "MB")


def test_it_ends_with_listeners_at_once(robot: Robot) -> None:
    """SIGTERM while ten listen: it lets them go, and is not killed."""
    process = psutil.Process(robot.pid("web"))
    gone = threading.Event()
    threading.Thread(target=lambda: (process.wait(PATIENCE_S), gone.set()), daemon=True).start()
    with _listening(robot) as listen:
        listen(LISTENERS)
        began_s = time.monotonic()
        process.terminate()
        assert gone.wait(PATIENCE_S)
        tell("SIGTERM to the end of web", time.monotonic() - began_s, 1.0, "s")
    assert next(x for x in robot.group.rows if x.process == "web").last_exit in ("exit 0", "")
