"""The operator's page in a real browser, on a robot that really runs.

Screenshots are kept in the folder `$ARTIFACTS`, or where pytest keeps its temporary files.
"""

from __future__ import annotations

import math
import os
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from runtime import messages as m
from runtime.hubs import address_file, free_port
from tests.e2e.conftest import Robot, elbow, running

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or ""

pytest.importorskip("starlette", reason="needs the extra myograft[web]")
playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra myograft[dev]")
from axe_playwright_python.sync_playwright import Axe  # noqa: E402
from playwright.sync_api import Browser, Page, Request, Route, expect, sync_playwright  # noqa: E402

from dashboard.web.picture import Picture  # noqa: E402
from tests.unit.page_server import Page as Server  # noqa: E402
from tests.unit.page_server import elbow as shipped  # noqa: E402
from tests.unit.page_server import served  # noqa: E402

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.skipif(not CHROMIUM, reason="needs a browser: apt-get install chromium"),
]

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
SPEED = 2.0
PATIENCE_MS = 60_000
WIDE = {"width": 1400, "height": 1000}
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("seat")
    with running(elbow(folder, "seat"), folder, speed=SPEED) as robot:
        yield robot


@pytest.fixture(scope="module")
def address(robot: Robot) -> str:
    return address_file(robot.group.run_dir, "web").read_text()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def page(browser: Browser, address: str) -> Iterator[Page]:
    """One page that stays open through all that follows."""
    page = browser.new_page(viewport=WIDE)  # type: ignore[arg-type]
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(address)
    yield page
    assert wrong == []
    page.close()


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = os.environ.get("ARTIFACTS")
    folder = Path(kept) if kept else tmp_path_factory.mktemp("page")
    folder.mkdir(parents=True, exist_ok=True)
    print(f"screenshots in {folder}")
    return folder


def accessible(page: Page) -> None:
    found = Axe().run(page).response["violations"]
    serious = [x for x in found if x["impact"] in ("serious", "critical")]
    told = [f"{x['id']}: {x['help']}: {[n['target'] for n in x['nodes']]}" for x in serious]
    assert told == []


def module_of(muscle: str) -> str:
    return f"#chains li[data-muscle='{muscle}']"


LOOK_OUT = """() => {
    const shown = () => SHOWN;
    window.seen = new Promise((resolve) => {
        const look = () => shown() && (observer.disconnect(), resolve());
        const observer = new MutationObserver(look);
        observer.observe(document, {subtree: true, childList: true, attributes: true});
    });
}"""


@contextmanager
def seen(what: str, *pages: Page) -> Iterator[None]:
    """Each page shows it (JavaScript) once, for however short a time, in what is done here."""
    for page in pages:
        page.evaluate(LOOK_OUT.replace("SHOWN", what))
    yield
    for page in pages:
        page.evaluate("window.seen")


def test_the_chain_is_drawn_and_the_controls_are_ready(page: Page, shots: Path) -> None:
    expect(page.locator("#robot")).to_have_text("seat")
    expect(page.get_by_role("status", name="What the robot does")).to_have_text("hold")
    expect(page.get_by_role("button", name="Go there")).to_be_enabled()
    names = page.locator("#chains li h4")
    expect(names).to_have_text(["triceps", "biceps_1", "biceps_2", "elbow"])
    gauge = page.get_by_role("meter", name="tension of triceps")
    expect(gauge).to_have_attribute("aria-valuemax", "150")
    expect(gauge).not_to_have_attribute("aria-valuenow", "0")
    expect(page.locator("#processes tbody tr[data-process='driver-arm']")).to_contain_text("ready")
    expect(page.locator("#schema tbody tr.active")).to_contain_text("shipped")
    page.screenshot(path=shots / "light.png", full_page=True)
    accessible(page)


def test_in_the_dark_and_on_a_phone(browser: Browser, address: str, shots: Path) -> None:
    for name, scheme, size in (("dark", "dark", WIDE), ("phone", "light", PHONE)):
        context = browser.new_context(viewport=size, color_scheme=scheme)  # type: ignore[arg-type]
        page = context.new_page()
        page.goto(address)
        expect(page.locator("#stage")).to_have_text("hold")
        expect(page.locator("#chains li h4")).to_have_count(4)
        gauge = page.get_by_role("meter", name="tension of triceps")
        expect(gauge).not_to_have_attribute("aria-valuenow", "0")
        page.screenshot(path=shots / f"{name}.png", full_page=True)
        page.get_by_role("button", name="Unplug triceps").click()
        expect(page.get_by_role("button", name="Sure? Unplug triceps")).to_have_text("Sure?")
        expect(page.locator("#said")).to_have_text("Unplug triceps? Press again to be sure.")
        accessible(page)
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width <= size["width"], "it has to be scrolled sideways"
        assert page.locator("#estop").is_visible()
        context.close()


def test_by_keyboard_alone(page: Page, robot: Robot) -> None:
    since = robot.watch.mark()
    page.get_by_role("spinbutton", name="elbow, degrees").focus()
    page.keyboard.press("Control+a")
    page.keyboard.type("30")
    page.keyboard.press("Enter")
    expect(page.locator("#answers .good")).to_contain_text("on the way")
    robot.watch.wait_for(
        m.ExecutiveState,
        lambda x: bool(x.reference_rad) and abs(x.reference_rad[0] - 0.5236) < 1e-3,
        since=since,
    )


def test_a_muscle_is_plugged_in_and_all_pages_see_it_grow(
    browser: Browser, page: Page, address: str, shots: Path
) -> None:
    other = browser.new_page()
    other.goto(address)
    page.get_by_label("Spare").select_option("biceps_3")
    page.get_by_role("button", name="Plug in").click()
    expect(page.locator("#answers .good").last).to_contain_text("biceps_3")
    for each in (page, other):
        expect(each.locator(module_of("biceps_3"))).to_be_visible()
        expect(each.locator("#detail")).to_contain_text("taking in biceps_3")
        expect(each.locator("#events")).to_contain_text("biceps_3")
    expect(page.get_by_role("button", name="Plug in")).to_be_hidden()
    expect(page.locator("#plug-note")).to_have_text("Every muscle is plugged in.")
    led = f'document.querySelector("{module_of("biceps_1")} .led.on")'
    with seen(led, page, other):
        page.get_by_role("button", name="Identify biceps_1").click()
    expect(page.locator("#stage")).to_have_text("collect")
    page.screenshot(path=shots / "growing.png", full_page=True)
    other.close()


def test_the_key_stops_the_arm_and_reset_lets_it_hold(
    page: Page, robot: Robot, shots: Path
) -> None:
    since = robot.watch.mark()
    page.locator("h1").click()
    page.keyboard.press("Escape")
    robot.watch.wait_for(m.ChainState, lambda x: x.mode == "stopping", since=since)
    expect(page.locator("#answers .good").last).to_contain_text("pay out until slack")
    robot.watch.wait_for(m.ChainState, lambda x: x.mode == "stopped", since=since)
    expect(page.get_by_role("alert").first).to_contain_text("Stopped and latched")
    expect(page.locator("#stage")).to_have_text("stopped")
    page.screenshot(path=shots / "stopped.png", full_page=True)
    accessible(page)
    expect(page.locator("#detail")).to_contain_text("Reset: hold where the arm is")
    for name in ("hold", "Go there", "Relearn"):
        expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    page.get_by_role("alert").get_by_role("button", name="Reset").click()
    expect(page.locator("#answers .good").last).to_contain_text("holds where it is")
    expect(page.locator("#stage")).to_have_text("hold")
    expect(page.locator("#alarm")).to_be_empty()
    hold = page.get_by_role("button", name="hold", exact=True)
    expect(hold).to_be_enabled()
    expect(hold).to_have_attribute("aria-pressed", "true")


def test_a_process_is_killed_and_seen_to_return(page: Page, robot: Robot) -> None:
    row = page.locator("#processes tbody tr[data-process='estimator']")
    expect(row.locator("[data-name='restarts']")).to_have_text("0")
    robot.kill("estimator")
    expect(row.locator("[data-name='restarts']")).to_have_text("1")
    expect(row.locator("[data-name='state']")).to_have_text("ready")
    expect(row.locator("[data-name='last_exit']")).to_have_text("killed by SIGKILL")
    expect(page.locator("#events")).to_contain_text("estimator is back")


def test_a_stop_that_does_not_get_through_is_said(page: Page) -> None:
    page.route("**/api/request/estop", lambda route: route.abort())
    page.get_by_role("button", name="STOP").click()
    expect(page.locator("#answers .bad").last).to_contain_text("NO ANSWER")
    expect(page.locator("#answers .bad").last).to_contain_text("myograft estop seat")
    page.unroute("**/api/request/estop")


def test_a_page_that_nobody_sees_lets_go_of_its_stream(browser: Browser, address: str) -> None:
    """Here in a browser that cannot share one among its pages."""
    page = browser.new_page()
    page.add_init_script("delete globalThis.SharedWorker")
    page.clock.install()
    page.goto(address)
    expect(page.locator("#stage")).to_have_text("hold")

    def show(hidden: str) -> None:
        page.evaluate(f"""() => {{
            Object.defineProperty(document, "hidden", {{value: {hidden}, configurable: true}});
            document.dispatchEvent(new Event("visibilitychange"));
        }}""")

    def is_stream(request: Request) -> bool:
        return request.url.endswith("/api/stream")

    show(hidden="true")
    with page.expect_event("requestfailed", is_stream):
        page.clock.fast_forward(6000)
    with page.expect_request(is_stream):
        show(hidden="false")
    before = page.locator("#clock").inner_text()
    expect(page.locator("#clock")).not_to_have_text(before)
    expect(page.locator("#alarm")).to_be_empty()
    page.close()


def test_the_server_is_restarted_under_an_open_page(page: Page, robot: Robot, shots: Path) -> None:
    lost = "document.getElementById('alarm').textContent.includes('server does not answer')"
    with seen(f"{lost} && document.getElementById('controls').disabled", page):
        robot.kill("web")
    page.screenshot(path=shots / "lost.png")
    expect(page.locator("#alarm")).to_be_empty()
    expect(page.get_by_role("button", name="Go there")).to_be_enabled()
    row = page.locator("#processes tbody tr[data-process='web']")
    expect(row.locator("[data-name='restarts']")).to_have_text("1")
    page.get_by_role("button", name="hold", exact=True).click()
    expect(page.locator("#answers .good").last).to_contain_text("holding")


def test_results_are_shown_and_the_stop_is_there_too(
    browser: Browser, robot: Robot, address: str, shots: Path
) -> None:
    """However many pages are open: a browser has six connections to one server."""
    context = browser.new_context(viewport=WIDE)  # type: ignore[arg-type]
    page = context.new_page()
    page.goto(f"{address}/results#lift")
    expect(page.locator("#stage")).to_have_text("seat: hold")
    pages = [context.new_page() for _ in range(6)]
    for each in pages:
        each.goto(address)
        expect(each.locator("#stage")).to_have_text("hold")
    expect(page.locator("#tables table").first).to_contain_text("before")
    expect(page.locator("#pictures img").first).to_be_visible()
    page.screenshot(path=shots / "results.png")
    accessible(page)
    since = robot.watch.mark()
    page.keyboard.press("Escape")
    robot.watch.wait_for(m.ChainState, lambda x: x.mode == "stopping", since=since)
    expect(page.locator("#answers .good")).to_contain_text("pay out until slack")
    expect(page.locator("#stage")).to_have_text("seat: stopped")
    for each in pages:
        expect(each.locator("#stage")).to_have_text("stopped")
    context.close()


@contextmanager
def fed(folder: Path) -> Iterator[Server]:
    """A server without a robot, fed by hand; its heart beats as the process's does."""
    over = threading.Event()
    with served(folder) as server:

        def beat() -> None:
            while not over.wait(0.5):
                server.publish("beat", time.monotonic())

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            yield server
        finally:
            over.set()
            thread.join()


def tell(server: Server, picture: Picture, *messages: m.Message) -> None:
    for message in messages:
        picture.receive(message, 0.0)
    for name, section in picture.sections(0.0, {}):
        server.publish(name, section)


def test_what_a_real_robot_and_another_run_look_like(browser: Browser, tmp_path: Path) -> None:
    modules = [
        m.ModuleInfo(name=name, kind="muscle", module_id=i, serial=i, state="up", tension_limit_n=9)
        for i, name in enumerate(("triceps", "biceps_1"), start=2)
    ]
    state = m.ChainState(
        chain="arm",
        muscles=("triceps", "biceps_1"),
        length_m=(0.1, 0.1),
        tension_n=(math.nan, 6.0),
        temperature_degc=(25.0, 25.0),
        target_length_m=(0.1, 0.1),
        mode="hold",
    )

    with fed(tmp_path) as server:
        group = m.GroupState(ready=True, run_dir="first", processes=())
        body = m.ChainBody(chain="arm", modules=tuple(modules))
        tell(server, Picture(shipped(), simulated=False), group, body, state)
        page = browser.new_page()
        page.goto(server.place.url)
        gauges = page.locator(module_of("triceps")).locator(".value")
        expect(gauges).to_have_text(["–", "25.0 of 80 °C"])
        bar = page.get_by_role("meter", name="tension of biceps_1").locator("i")
        expect(bar).to_have_class("amber")  # 6 of 9 N
        expect(page.get_by_role("button", name="Identify triceps")).to_be_visible()
        expect(page.get_by_role("button", name="Unplug triceps")).to_be_hidden()
        expect(page.get_by_role("button", name="Plug in")).to_be_hidden()
        expect(page.locator("#plug-note")).to_contain_text("by hand: the robot notices")
        again = Picture(shipped(), simulated=True)
        tell(server, again, body)
        with page.expect_navigation():
            tell(server, again, msgspec.structs.replace(group, run_dir="second"))
        expect(page.get_by_label("Spare").locator("option")).to_have_text(
            ["biceps_2 on arm", "biceps_3 on arm"]
        )
        page.close()


def test_the_view_has_its_stream_and_keeps_no_key_to_itself(
    browser: Browser, tmp_path: Path
) -> None:
    rr = pytest.importorskip("rerun", reason="needs the extra myograft[view]")
    port = free_port()
    stream = rr.RecordingStream("myograft test")
    stream.set_sinks(rr.GrpcServerSink("127.0.0.1", port, server_memory_limit="16MiB"))
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_MS)
    refused: list[str] = []
    page.on("console", lambda told: "Content Security" in told.text and refused.append(told.text))
    held: list[Route] = []  # before it draws: without a graphics card that takes all the time
    page.route("**/re_viewer_bg.wasm", lambda route: held.append(route))
    with fed(tmp_path) as server:
        server.viewer_url = f"rerun+http://127.0.0.1:{port}/proxy"
        tell(server, Picture(shipped(), simulated=True), viewer_event())
        page.goto(server.place.url)
        with page.expect_request("**/re_viewer_bg.wasm"):
            page.get_by_role("button", name="Show").click()
        page.frames[-1].wait_for_load_state()
        view = page.get_by_title("Live view by Rerun")
        view.click()
        page.keyboard.press("F6")
        expect(page.get_by_role("heading", name="Controls")).to_be_focused()
        view.click()
        page.keyboard.press("Escape")
        expect(page.locator("#answers .good")).to_contain_text("Stop")
        assert [type(request) for request in server.asked] == [m.Estop]
        with page.expect_response("**/rerun.sdk_comms.*/ReadMessages") as answer:
            held[0].continue_()
        assert answer.value.status == 200
        # It asks Rerun's site and others for news, and is rightly refused: we are at http.
        assert [text for text in refused if "https://" not in text] == []
        page.close()
    stream.disconnect()


def viewer_event() -> m.Event:
    data = {"url": "rerun+http://127.0.0.1:1/proxy"}
    return m.Event(process="viz", level="info", kind="viewer", text="live view", data=data)


def test_one_window_of_a_browser_has_the_view(browser: Browser, tmp_path: Path) -> None:
    context = browser.new_context()
    context.route("**/viewer/**", lambda route: route.fulfill(body=""))
    with fed(tmp_path) as server:
        tell(server, Picture(shipped(), simulated=True), viewer_event())
        first, second = (context.new_page() for _ in range(2))
        first.goto(server.place.url)
        first.get_by_role("button", name="Show").click()
        expect(first.get_by_title("Live view by Rerun")).to_be_visible()
        second.goto(server.place.url)
        expect(second.get_by_title("Live view by Rerun")).to_be_visible()
        expect(first.get_by_title("Live view by Rerun")).to_have_count(0)
        expect(first.locator("#view-note")).to_contain_text("Another window of this browser")
        first.get_by_role("button", name="Show").click()
        expect(second.get_by_title("Live view by Rerun")).to_have_count(0)
        context.close()


def test_a_wrong_token_is_told_and_the_right_one_leads_on(
    browser: Browser, tmp_path: Path, shots: Path
) -> None:
    with served(tmp_path, address="0.0.0.0") as server:
        page = browser.new_page(viewport=PHONE)  # type: ignore[arg-type]
        page.goto(f"http://127.0.0.1:{server.port}/results")
        page.get_by_label("Token").fill("nonsense")
        page.keyboard.press("Enter")
        expect(page.get_by_role("alert")).to_have_text("That is not the token of this robot.")
        page.screenshot(path=shots / "login.png")
        accessible(page)
        page.get_by_label("Token").fill(server.place.rules.token)
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="Results")).to_be_visible()
        page.close()


def test_the_robot_ends_and_the_page_says_so(page: Page, robot: Robot) -> None:
    """Last: the group is stopped as Ctrl-C does, and the server goes with it."""
    robot.group.stop(park=False)
    expect(page.locator("#alarm")).to_contain_text("The page's server does not answer")
    expect(page.locator("#alarm")).to_contain_text("myograft estop seat")
    expect(page.locator("#stage")).to_have_text("no connection")
    accessible(page)
