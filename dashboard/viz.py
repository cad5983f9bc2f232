"""Process: the robot as a picture. The only importer of Rerun; may die without the robot noticing.

It writes `<robot>.rrd` into the run's folder and serves the same live on loopback; the address is
told by an event of kind `viewer` and stands in `<robot>.viewer` beside the file. A restarted one
goes on in `<robot>-2.rrd` under the same recording id, so both files open as one run.
"""

from __future__ import annotations

from dashboard.blueprint import layout
from dashboard.body import Body
from dashboard.sinks import RerunCanvas, segment_file
from dashboard.stream import Stream
from dashboard.viewer import free_port
from runtime.process import Launch


def main(launch: Launch) -> None:
    """Draw until told to stop."""
    settings = launch.settings
    body = Body(settings)
    canvas = RerunCanvas(
        settings.name,
        launch.run_dir.name,
        layout(settings.joints, *body.bounds_m()),
        segment_file(launch.run_dir, settings.name),
        free_port(),
    )
    (launch.run_dir / f"{settings.name}.viewer").write_text(canvas.url)
    try:
        launch.run(Stream(settings, canvas, body, canvas.url))
    finally:
        canvas.close()
