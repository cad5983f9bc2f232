"""Journals: what is written is read, also after a kill."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from runtime.journal import Journal, JournalError, about, read
from runtime.messages import ChainBody, Event, ExecutiveState, Message, SchemaVersion

SECOND = 1_000_000_000


def some_messages(n: int) -> list[Message]:
    body = ChainBody(stamp_ns=1, chain="arm", modules=())
    schema = SchemaVersion(version=1, joints=("e",), muscles=(), method="iii", data=b"\x00\xff")
    states = [ExecutiveState(stamp_ns=i, stage="hold", step=i) for i in range(n)]
    return [body, schema, *states]


def test_round_trip(tmp_path: Path) -> None:
    written = some_messages(20)
    path = tmp_path / "messages.mcap"
    with Journal(path, "elbow") as journal:
        for i, message in enumerate(written):
            journal.write(message, wall_ns=i)
    entries = list(read(path))
    assert [entry.message for entry in entries] == written
    assert entries[0].key == "elbow/chain/arm/body"
    assert entries[-1].wall_ns == len(written) - 1


def test_other_peoples_tools_read_it(tmp_path: Path) -> None:
    path = tmp_path / "messages.mcap"
    with Journal(path, "elbow") as journal:
        for message in some_messages(3):
            journal.write(message, wall_ns=5)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 5
    assert {schema.name for schema in summary.schemas.values()} >= {"ChainBody", "ExecutiveState"}


def test_a_kill_costs_a_quarter_of_a_second(tmp_path: Path) -> None:
    path = tmp_path / "messages.mcap"
    journal = Journal(path, "elbow")  # never closed, as after kill -9
    for i in range(35):
        journal.write(ExecutiveState(stage="hold", step=i), wall_ns=SECOND + i * SECOND // 10)
    on_disk = path.read_bytes()  # what the kernel has; the rest dies with the process
    found = list(read(path))
    assert 32 <= len(found) <= 35
    for torn in (len(on_disk) - 1, len(on_disk) - 100, len(on_disk) // 2):
        short = tmp_path / f"{torn}.mcap"
        short.write_bytes(on_disk[:torn])
        assert [e.message for e in read(short)] == [e.message for e in found][
            : len(list(read(short)))
        ]
    assert list(read(tmp_path / f"{len(on_disk) // 2}.mcap"))
    journal.__exit__(None, None, None)


def test_a_quiet_robot_is_flushed_too(tmp_path: Path) -> None:
    with Journal(tmp_path / "messages.mcap", "elbow") as journal:
        event = Event(process="p", level="info", kind="k", text="t")
        journal.write(event, wall_ns=SECOND)
        journal.write(event, wall_ns=SECOND + 1)
        journal.flush_if_due(wall_ns=2 * SECOND + 1)
        assert len(list(read(journal.path))) == 2


def test_never_overwrites(tmp_path: Path) -> None:
    path = tmp_path / "messages.mcap"
    path.write_bytes(b"something dear")
    with pytest.raises(FileExistsError):
        Journal(path, "elbow")


@pytest.mark.parametrize("content", [b"", b"no mcap", b"no mcap file at all"])
def test_what_is_no_journal_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "messages.mcap"
    path.write_bytes(content)
    with pytest.raises(JournalError):
        list(read(path))


def test_it_says_whose_it_is_and_how_long_also_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "messages.mcap"
    journal = Journal(path, "left", "robots/elbow.toml")
    assert about(path) == ("left", "robots/elbow.toml", 0, 0)
    for i in range(21):
        journal.write(ExecutiveState(stage="hold", step=i), wall_ns=SECOND + i * SECOND // 10)
    killed = about(path)
    assert killed[:3] == ("left", "robots/elbow.toml", SECOND)
    assert 2.75 * SECOND <= killed.end_ns <= 3 * SECOND
    journal.__exit__(None, None, None)
    assert about(path).end_ns == 3 * SECOND


def test_only_what_is_asked_for_is_read(tmp_path: Path) -> None:
    path = tmp_path / "messages.mcap"
    with Journal(path, "elbow") as journal:
        for message in some_messages(20):
            journal.write(message, wall_ns=1)
    kinds = {type(entry.message) for entry in read(path, (ChainBody, SchemaVersion))}
    assert kinds == {ChainBody, SchemaVersion}


def test_a_damaged_chunk_costs_itself(tmp_path: Path) -> None:
    path = tmp_path / "messages.mcap"
    with Journal(path, "elbow") as journal:
        for i in range(40):
            journal.write(ExecutiveState(stage="hold", step=i), wall_ns=SECOND + i * SECOND // 10)
    whole = [entry.message for entry in read(path)]
    data = path.read_bytes()
    for place in range(len(data) // 3, len(data) // 2, 7):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        left = [entry.message for entry in read(path)]
        assert set(left) <= set(whole)
        about(path)
    first = data.index(b"\x28\xb5\x2f\xfd") + 12  # in the first compressed chunk
    path.write_bytes(data[:first] + bytes([data[first] ^ 0xFF]) + data[first + 1 :])
    assert len(whole) - 10 <= len([*read(path)]) < len(whole)
    path.write_bytes(data[: len(data) // 3] + b"\xff" + data[len(data) // 3 + 1 :])
    left = [entry.message for entry in read(path)]
    assert len(whole) - 10 <= len(left) < len(whole)
    assert left[-1] == whole[-1]
