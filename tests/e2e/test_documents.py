"""What the documents show of a running robot is done, command by command, on one that runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from runtime import messages as m
from runtime.bus import Bus
from runtime.cli.main import DONE, main
from runtime.hubs import find_hub, living_hubs
from tests.e2e.conftest import PATIENCE_S, Command, Watch, elbow
from tests.shown import TUTORIAL, Shown, shown

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

SPEED = "3"
HASTE = """
[growth]
n_new = 3
n_check = 1
[control]
joint_speed_deg_s = 120.0
settle_s = 0.3
"""
TRAINING_S = 180.0  # of wall time, in which it steps back behind all others
FOLLOWS = {  # how a command begins -> events of which one says that it is over
    "plug": ("grow_done", "refit_done"),
    "unplug": ("lost",),
    "fault rupture": ("shrink_done",),
    "schema relearn": ("grow_done",),
    "task": ("task_done",),
    "estop": ("stopped",),
}


@contextmanager
def running(folder: Path) -> Iterator[tuple[Command, Watch]]:
    """`myograft up elbow` in haste, with fewer and faster motions, and someone who watches."""
    file = Path(elbow(folder, "elbow", steps=2).file)
    file.write_text(file.read_text() + HASTE)
    up = Command("up", str(file), "--speed", SPEED)
    try:
        up.wait_line("ready after")
        with Bus("elbow", "test", endpoint=find_hub().endpoint) as bus, Watch(bus) as watch:
            rest(watch, "hold")
            yield up, watch
    finally:
        up.end()


def rest(watch: Watch, stage: str) -> None:
    """Wait until the arm has come to rest in that stage."""
    watch.wait_for(
        m.ExecutiveState,
        lambda x: x.stage == stage and (x.settled or stage == "stopped"),
        since=watch.mark(),
        timeout_s=PATIENCE_S,
        what=f"the arm in stage {stage}",
    )


def carry_out(command: Shown, watch: Watch) -> None:
    """Run it as a person would, and wait for what it promises."""
    since = watch.mark()
    words = command.words[1:]
    if command.endless:
        process = Command(*words)
        process.wait_line("")
        assert process.end() in (DONE, 130), str(command)
        return
    assert main(list(words)) == DONE, str(command)
    kinds = next((k for begin, k in FOLLOWS.items() if " ".join(words).startswith(begin)), ())
    if kinds:
        watch.wait_for(
            m.Event, lambda x: x.kind in kinds, since=since, timeout_s=TRAINING_S, what=str(command)
        )
    rest(watch, "stopped" if words[0] == "estop" else "hold")


def test_the_tutorial_and_all_others_do_what_they_show(tmp_path: Path) -> None:
    live = [command for command in shown() if command.on_robot and command.robot == "elbow"]
    first = [command for command in live if command.document == TUTORIAL]
    done = {command.words for command in first}
    others = {x.words: x for x in live if x.words not in done}.values()
    *story, last = first
    assert last.ours == "down"
    with running(tmp_path) as (up, watch):
        for command in (*story, *others):
            started_s = time.monotonic()
            carry_out(command, watch)
            print(f"{time.monotonic() - started_s:5.1f} s  {command}")
        adopted = [version.method for version in watch.of(m.SchemaVersion)]
        assert list(dict.fromkeys(adopted)) == ["shipped", "iv", "shrink", "refit"]
        assert main(list(last.words[1:])) == DONE
        assert up.over() == 0
    assert living_hubs() == []
