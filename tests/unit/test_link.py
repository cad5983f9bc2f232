"""Links by URL, and the driver on a real serial port's stand-in, a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hardware_sim.chain import Chain
from hardware_sim.firmware import JointModule
from hardware_sim.pty import PtyChain
from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.wire import packet as wire
from runtime.wire.link import LinkError, SerialLink, SerialPort, expected_answers, parse_link
from services.logic.muscle_driver import MuscleDriver
from services.muscle_driver import OverSerial
from tests.unit.driver_bench import MS, SETTINGS

PATIENCE_S = 0.2  # of the terminal's thread, on a busy machine


def test_urls() -> None:
    assert parse_link("sim:") is None
    assert parse_link("serial:///dev/ttyUSB0?baud=1000000") == SerialPort("/dev/ttyUSB0", 1_000_000)
    assert parse_link("serial:///dev/ttyUSB0", baud=57_600) == SerialPort("/dev/ttyUSB0", 57_600)


@pytest.mark.parametrize(
    "url",
    [
        "",
        "sim",
        "tcp://host:1",
        "serial:/",
        "serial://dev/ttyUSB0",
        "serial:///dev/ttyUSB0?baud=fast",
        "serial:///dev/ttyUSB0?baud=0",
        "serial:///dev/ttyUSB0?bits=8",
    ],
)
def test_a_url_that_makes_no_sense_says_what_would(url: str) -> None:
    with pytest.raises(LinkError, match=r"serial:///dev/ttyUSB0\?baud=3000000"):
        parse_link(url)


def test_a_port_that_is_not_there_says_what_to_do() -> None:
    with pytest.raises(LinkError, match="plugged in"):
        SerialLink(SerialPort("/dev/no_such_port", 1_000_000))


@pytest.mark.parametrize(
    ("packets", "count"),
    [
        ([wire.ping(2)], 1),
        ([wire.ping()], wire.MAX_ID),
        ([wire.sync_write(720, 1, {2: b"\0"}), wire.sync_read(740, 9, [2, 3, 100])], 3),
        ([wire.sync_read(740, 9, [2, 3], fast=True)], 1),
        ([wire.bulk_read({2: (740, 9), 3: (64, 1)})], 2),
        ([wire.action()], 0),
        ([], 0),
    ],
)
def test_knows_how_many_answers_to_wait_for(
    packets: list[wire.InstructionPacket], count: int
) -> None:
    assert expected_answers(b"".join(map(wire.encode, packets))) == count


@pytest.fixture
def link() -> Iterator[SerialLink]:
    """A chain with a joint module on id 100, behind a pseudo-terminal."""
    chain = Chain("arm")
    chain.plug(JointModule(9, lambda: 0.5, 100, "elbow"))
    with PtyChain(chain) as terminal:
        link = SerialLink(SerialPort(terminal.path, 3_000_000), timeout_s=PATIENCE_S)
        yield link
        link.close()


def test_gives_one_reply_to_each_request_under_its_number(link: SerialLink) -> None:
    def exchange(packet: wire.InstructionPacket, sequence: int) -> m.BusReply:
        data = wire.encode(packet)
        return link.exchange(m.BusRequest(chain="arm", sequence=sequence, data=data))

    reply = exchange(wire.read(100, 740, 4), 7)
    assert (reply.chain, reply.sequence) == ("arm", 7)
    (status,) = wire.Decoder().feed(reply.data)
    assert status.params == (500_000).to_bytes(4, "little")
    assert exchange(wire.ping(1), 8) == m.BusReply(chain="arm", sequence=8, data=b"")


def test_the_driver_runs_on_a_serial_port(link: SerialLink) -> None:
    driver = OverSerial(MuscleDriver(SETTINGS, "arm", MemoryStore()), link)
    seen: list[m.Message] = []
    for cycle in range(12):
        seen += driver.tick((1000 + cycle) * 5 * MS)
    joints = [message for message in seen if isinstance(message, m.JointState)]
    assert joints[-1].joints == ("elbow",)
    assert joints[-1].angle_rad == pytest.approx((0.5,))
    assert not any(isinstance(message, m.BusRequest) for message in seen)
    lost = [message.data["muscle"] for message in seen if isinstance(message, m.Event)]
    assert lost == ["m2", "m3"]
