"""Process: the robot as a picture. The only importer of Rerun; may die without the robot noticing.

It writes `<robot>.rrd` into the run's folder and serves the same live on loopback; the address is
told by an event of kind `viewer` and stands in `<robot>.viewer` beside the file. A restarted one
goes on in `<robot>-2.rrd` under the same recording id, so both files open as one run.

It looks at the bus at a steady pace instead of at every arrival: a thousand wake-ups a second
would cost more than all the drawing. What came in between waits in order, in queues that are
bounded, so the robot never waits for the picture.
"""

from __future__ import annotations

import gc
import socket
import time
from collections import deque
from operator import attrgetter
from pathlib import Path

from dashboard.blueprint import layout
from dashboard.body import Body
from dashboard.plots import MANY
from dashboard.sinks import RerunCanvas, segment_file
from dashboard.stream import Stream
from runtime.hubs import free_port
from runtime.messages import ChainState, JointEstimate, Message, TrainingProgress
from runtime.process import Launch
from runtime.settings import RobotSettings

PACE_S = 0.064  # the body and its joints move at this pace, curves grow at a third of it
# Every sample of these is drawn, of other states the newest at each look.
CURVES = (ChainState, JointEstimate, TrainingProgress)
GARBAGE = 20_000  # new objects before looking for cycles: what waits to be drawn is no garbage
MAX_EARLY = 4096  # arrivals before robot time is known


def main(launch: Launch) -> None:
    """Draw until told to stop."""
    settings = launch.settings
    file = segment_file(launch.run_dir, settings.name)
    body, canvas = canvas_of(settings, launch.run_dir.name, file, free_port())
    (launch.run_dir / f"{settings.name}.viewer").write_text(canvas.url)
    try:
        _loop(launch, Stream(settings, canvas, body, canvas.url, socket.gethostname()))
    finally:
        canvas.close()


def canvas_of(
    settings: RobotSettings, run: str, file: Path, port: int = 0
) -> tuple[Body, RerunCanvas]:
    """A robot's body and the canvas that it is drawn on; with a port, also served there."""
    body = Body(settings)
    axes = body.axes(settings.joints)
    many = len(settings.muscles) > MANY
    role = settings.role if many else ""
    picture = layout(axes, *body.bounds_m(), settings.module.tension_limit_n, role, many)
    return body, RerunCanvas(settings.name, run, axes, picture, file, port)


def _loop(launch: Launch, stream: Stream) -> None:
    gc.set_threshold(GARBAGE)
    with launch.open_bus() as member:
        member.subscribe(*(kind for kind in stream.inputs if kind not in CURVES), poll=True)
        member.subscribe(*CURVES, every=True, poll=True)
        member.ready()
        arrived: deque[Message] = deque(maxlen=MAX_EARLY)
        due_s = time.monotonic()
        while not member.stopping:
            wall_s = time.monotonic()
            due_s = max(due_s + PACE_S, wall_s)
            time.sleep(due_s - wall_s)
            news = [item for item in member.wait(0.0) if isinstance(item, Message)]
            arrived.extend(sorted(news, key=attrgetter("stamp_ns")))  # as they were said
            now_ns = member.now_ns()
            if now_ns is None:
                continue  # the world has not told the time yet
            while arrived:
                stream.receive(arrived.popleft(), now_ns)
            for message in stream.tick(now_ns):
                member.publish(message)
            member.beat(now_ns)
