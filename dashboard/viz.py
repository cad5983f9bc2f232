"""Process: the robot as a picture. The only importer of Rerun; may die without the robot noticing.

It writes `<robot>.rrd` into the run's folder and serves the same live on loopback; the address is
told by an event of kind `viewer` and stands in `<robot>.viewer` beside the file. A restarted one
goes on in `<robot>-2.rrd` under the same recording id, so both files open as one run.

It looks at the bus at a steady pace instead of at every arrival: three hundred wake-ups a second
would cost more than all the drawing, and no eye sees more than fifty points a second.
"""

from __future__ import annotations

import time
from collections import deque

from dashboard.blueprint import layout
from dashboard.body import Body
from dashboard.plots import MANY
from dashboard.sinks import RerunCanvas, segment_file
from dashboard.stream import Stream
from dashboard.viewer import free_port
from runtime.bus import Question
from runtime.messages import Message
from runtime.process import Launch

PACE_S = 0.02
MAX_EARLY = 4096  # arrivals before robot time is known


def main(launch: Launch) -> None:
    """Draw until told to stop."""
    settings = launch.settings
    body = Body(settings)
    canvas = RerunCanvas(
        settings.name,
        launch.run_dir.name,
        layout(
            body.ranges_deg(settings.joints),
            *body.bounds_m(),
            settings.role if len(settings.muscles) > MANY else "",
        ),
        segment_file(launch.run_dir, settings.name),
        free_port(),
    )
    (launch.run_dir / f"{settings.name}.viewer").write_text(canvas.url)
    try:
        _loop(launch, Stream(settings, canvas, body, canvas.url))
    finally:
        canvas.close()


def _loop(launch: Launch, stream: Stream) -> None:
    with launch.open_bus() as member:
        member.subscribe(*stream.inputs)
        member.ready()
        arrived: deque[Message | Question] = deque(maxlen=MAX_EARLY)
        while not member.stopping:
            time.sleep(PACE_S)
            arrived.extend(member.wait(0.0))
            now_ns = member.now_ns()
            if now_ns is None:
                continue  # the world has not told the time yet
            while arrived:
                item = arrived.popleft()
                if not isinstance(item, Question):
                    stream.receive(item, now_ns)
            for message in stream.tick(now_ns):
                member.publish(message)
            member.beat(now_ns)
