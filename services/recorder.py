"""Process: every message of the robot to an MCAP file in the run's folder.

The raw bytes of the simulated line are left out, being four fifths of the traffic, unless
MYOGRAFT_RECORD_LINE is set.
"""

from __future__ import annotations

import itertools
import os
import time
from pathlib import Path

from runtime.bus import Question
from runtime.journal import Journal
from runtime.member import Member
from runtime.messages import BusReply, BusRequest, Message
from runtime.process import Launch
from runtime.topics import TOPICS

PACE_S = 0.02  # between two looks: to be woken by each message costs more than to write it
SEGMENT_S = 1800.0  # of wall time in one file: its index is kept in memory, 2 MB a minute


def main(launch: Launch) -> None:
    """Record until told to stop."""
    line = () if os.environ.get("MYOGRAFT_RECORD_LINE") else (BusRequest, BusReply)
    kinds: list[type[Message]] = [row.message for row in TOPICS if row.message not in line]
    with launch.open_bus() as member:
        journal = _new_journal(launch)  # first: who is ready has a file to write to
        member.subscribe(*kinds, every=True)
        member.ready()
        while True:
            with journal:
                _fill(journal, member)
            if member.stopping:
                return
            journal = _new_journal(launch)


def _new_journal(launch: Launch) -> Journal:
    return Journal(_free_file(launch.run_dir), launch.settings.name, launch.settings.file)


def _fill(journal: Journal, member: Member) -> None:
    full, until_s = False, time.monotonic() + SEGMENT_S
    while not (member.stopping or full):
        time.sleep(PACE_S)
        items = member.wait(0.0)
        wall_ns = time.time_ns()
        for item in items:
            if not isinstance(item, Question):
                journal.write(item, wall_ns)
        journal.flush_if_due(wall_ns)
        member.beat(member.now_ns() or 0)
        full = time.monotonic() >= until_s


def _free_file(folder: Path) -> Path:
    """`messages.mcap`, then `messages-2.mcap`: nothing is overwritten."""
    names = itertools.chain(["messages.mcap"], (f"messages-{n}.mcap" for n in itertools.count(2)))
    return next(path for path in (folder / name for name in names) if not path.exists())
