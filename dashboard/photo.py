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

PATIENCE_S = 60.0
LOOK_S = 0.5  # between two looks whether the screen still changes


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
                _await_data(viewer)
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


def _await_data(viewer: ViewerClient) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        state = viewer.get_state()
        if not state.loading and any(r.current_time is not None for r in state.recordings):
            return
        time.sleep(0.1)
    raise ViewerError(f"nothing to show came within {PATIENCE_S:.0f} s")


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
