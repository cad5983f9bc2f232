"""The screen as a PNG, without a screen: Rerun's own viewer, headless, by a Vulkan driver."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dashboard.viewer import ViewerError, viewer_binary
from runtime.hubs import free_port

if TYPE_CHECKING:  # the command is listed without importing Rerun
    from rerun.experimental import ViewerClient

PATIENCE_S = 60.0  # for anything to come
LONGEST_S = 300.0  # for all of it
LOOK_S = 0.5  # between two looks whether the screen still changes
LIVE = 3.0  # what comes faster than this many times real time is the past


def photograph(
    sources: Sequence[str],
    picture: Path,
    at_s: float | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> None:
    """Write what a person would see of these recordings, or of a robot that runs.

    Args:
        sources: files of one run, or a live address.
        picture: the PNG to write.
        at_s: robot time; None: the newest.
        say: is told what is being done: it can take half a minute.

    Raises:
        ViewerError: no viewer, no Vulkan driver, or nothing came.
    """
    if not picture.absolute().parent.is_dir():
        raise ViewerError(f"there is no folder {picture.absolute().parent}")
    binary = viewer_binary()
    from rerun.experimental import ViewerClient

    with tempfile.TemporaryDirectory() as scratch:
        os.environ.setdefault("RUST_LOG", "off")
        os.environ.setdefault("XDG_RUNTIME_DIR", scratch)
        try:
            say("starting Rerun's viewer without a window; the picture can take half a minute")
            with ViewerClient.spawn(
                headless=True, port=free_port(), executable_path=binary, hide_welcome_screen=True
            ) as viewer:
                say(f"reading {', '.join(sources)}")
                viewer.open(list(sources))
                _await_data(viewer, say)
                if at_s is not None:
                    viewer.set_time(duration=at_s, play_state="paused")
                say("drawing until the screen stands still")
                picture.write_bytes(_still(viewer))
        except ViewerError:
            raise
        except (OSError, RuntimeError) as error:
            raise ViewerError(
                f"the viewer drew no picture: {error}. It needs a Vulkan driver, in Debian: "
                f"apt-get install mesa-vulkan-drivers libvulkan1"
            ) from error


def _await_data(viewer: ViewerClient, say: Callable[[str], None]) -> None:
    """Until all is there: the past of a robot that runs comes first, faster than it happened."""
    began_s = looked_s = time.monotonic()
    newest_ns, looks_live = -1, 0
    while looks_live < 2:
        time.sleep(LOOK_S)
        state, before_s, looked_s = viewer.get_state(), looked_s, time.monotonic()
        times_ns = [x.current_time for x in state.recordings if x.current_time is not None]
        before_ns, newest_ns = newest_ns, max(times_ns, default=-1)
        passed_s = looked_s - began_s
        if newest_ns < 0:
            if passed_s > PATIENCE_S:
                raise ViewerError(f"nothing to show came within {PATIENCE_S:.0f} s")
        elif passed_s > LONGEST_S:
            say(f"not all came within {LONGEST_S:.0f} s: drawing what is here")
            return
        else:
            came_s, waited_s = (newest_ns - before_ns) * 1e-9, looked_s - before_s
            live = before_ns >= 0 and not state.loading and came_s <= LIVE * waited_s
            looks_live = looks_live + 1 if live else 0


def _still(viewer: ViewerClient) -> bytes:
    """A screenshot that is like the one before it; of a robot that runs, the third."""
    before = viewer.take_screenshot()
    for _ in range(2):
        time.sleep(LOOK_S)
        now = viewer.take_screenshot()
        if now == before:
            break
        before = now
    return before
