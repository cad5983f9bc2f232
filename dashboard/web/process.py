"""Process: the robot's page, for people. May die without the robot noticing.

One event loop does all: it looks at the bus ten times a second, which is as often as an eye needs,
and it serves. Requests to the robot wait for their answers in threads.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import time
from collections.abc import Iterator

import msgspec
import uvicorn
from starlette.types import ASGIApp

from dashboard.web.app import make_app
from dashboard.web.feed import Feed
from dashboard.web.picture import Picture
from dashboard.web.place import Place, PlaceError, take_place, told_address
from dashboard.web.results import folders_of, missing_folders
from runtime.bus import Question
from runtime.hubs import Hub, living_hubs
from runtime.member import Member
from runtime.messages import Event, SchemaRequest, VersionRow
from runtime.process import Launch
from runtime.settings_file import shown

RATE_HZ = 10.0
HUBS_S = 2.0  # between two looks for other robots
ASK_AGAIN_S = 2.0

log = logging.getLogger(__name__)


def main(launch: Launch) -> None:
    """Serve until told to stop."""
    with launch.open_bus(most_hz=RATE_HZ) as member:
        try:
            place = take_place(launch.settings, launch.run_dir, launch.state_dir / launch.process)
        except PlaceError as error:
            member.report("page_failed", f"no page: {error}")
            raise SystemExit(1) from error
        for folder in missing_folders(launch.settings):
            text = f"[web]: results folder {shown(folder)} does not exist"
            member.report("page_lacks", text, level="warning")
        asyncio.run(_serve(launch, member, place))


async def _serve(launch: Launch, member: Member, place: Place) -> None:
    picture, feed = Picture(launch.settings, launch.simulated, socket.gethostname()), Feed()
    app = make_app(
        feed,
        member.bus.request,
        place.rules,
        lambda: picture.viewer_url,
        folders_of(launch.settings),
    )
    server = make_server(app, place)
    serving = asyncio.create_task(server.serve([place.socket]))
    member.subscribe(*Picture.inputs)
    member.ready()
    member.publish(
        Event(
            stamp_ns=member.now_ns() or 0,
            process=member.process,
            level="info",
            kind="page",
            text=f"the robot's page is at {place.told}",
            data={"url": place.url},
        )
    )
    asking = asyncio.create_task(_ask_for_versions(member, picture))
    try:
        await _look(member, picture, feed, serving)
    finally:
        asking.cancel()
        feed.end()
        server.should_exit = True
        await serving


async def _look(member: Member, picture: Picture, feed: Feed, serving: asyncio.Task[None]) -> None:
    """Bus to feed, until told to stop."""
    hubs: dict[str, tuple[Hub, str]] = {}
    hubs_due_s = 0.0
    encode = msgspec.json.Encoder().encode
    while not (member.stopping or serving.done()):
        await asyncio.sleep(1.0 / RATE_HZ)
        now_s = time.monotonic()
        for item in member.wait(0.0):
            if not isinstance(item, Question):
                try:
                    picture.receive(item, now_s)
                except ValueError as error:
                    log.warning("could not take %s: %s", type(item).__name__, error)
        if now_s >= hubs_due_s:
            hubs_due_s = now_s + HUBS_S
            hubs = {hub.robot: (hub, told_address(hub.run_dir)) for hub in living_hubs()}
        for name, section in picture.sections(now_s, hubs):
            feed.publish(name, encode(section))
        feed.publish("beat", b"%d" % now_s)  # so that a page knows that its server lives
        if (now_ns := member.now_ns()) is not None:
            member.beat(now_ns)


async def _ask_for_versions(member: Member, picture: Picture) -> None:
    """Keep the picture's list of schema versions fresh."""
    while True:
        await asyncio.sleep(1.0 / RATE_HZ)
        if not picture.versions_stale:
            continue
        picture.versions_stale = False
        replies = await asyncio.to_thread(member.bus.request, SchemaRequest(action="list"))
        rows = [reply.data["rows"] for reply in replies if reply.ok and "rows" in reply.data]
        try:
            picture.take_versions(msgspec.json.decode(rows[0], type=list[VersionRow]))
        except (IndexError, msgspec.MsgspecError) as error:
            if rows:
                log.warning("the list of versions cannot be read: %s", error)
            await asyncio.sleep(ASK_AGAIN_S)
            picture.versions_stale = True


def make_server(app: ASGIApp, place: Place) -> uvicorn.Server:
    """What serves `app`; `place` says whether over TLS."""
    return _Server(
        uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            ws="none",
            ssl_certfile=place.certificate or None,
            ssl_keyfile=place.key or None,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
    )


class _Server(uvicorn.Server):
    """Signals are the process's, not the server's."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave them as they are."""
        yield
