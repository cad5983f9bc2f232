"""ROBOTIS's own client meets a simulated chain over a pseudo-terminal, as it meets hardware."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from dynamixel_sdk import (
    BROADCAST_ID,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    PacketHandler,
    PortHandler,
    port_handler,
)

from hardware_sim.chain import Chain
from hardware_sim.firmware import MuscleModule
from hardware_sim.module import JointModule
from hardware_sim.muscle_bank import MuscleBank
from hardware_sim.pty import PtyChain

BAUD = 1_000_000
LATENCY_MS = 100.0  # of the line; the SDK's 16 are short for a thread on a busy machine
SDK = PacketHandler(2.0)
MUSCLE, JOINT = 0x4D31, 0x4A31


@pytest.fixture
def chain() -> Chain:
    bank, chain = MuscleBank(), Chain("arm", BAUD)
    for module_id in (2, 3):
        module = MuscleModule(bank, bank.add(), serial=1000 + module_id, module_id=module_id)
        chain.plug(module)
    chain.plug(JointModule(1100, lambda: 0.25, module_id=100))
    return chain


@pytest.fixture
def port(chain: Chain, monkeypatch: pytest.MonkeyPatch) -> Iterator[PortHandler]:
    monkeypatch.setattr(port_handler, "LATENCY_TIMER", LATENCY_MS)
    with PtyChain(chain) as terminal:
        port = PortHandler(terminal.path)
        assert port.openPort()
        assert port.setBaudRate(BAUD)
        yield port
        port.closePort()


def test_ping(port: PortHandler) -> None:
    assert SDK.ping(port, 2) == (MUSCLE, COMM_SUCCESS, 0)
    assert SDK.ping(port, 100) == (JOINT, COMM_SUCCESS, 0)
    assert SDK.ping(port, 9)[1] == COMM_RX_TIMEOUT


def test_broadcast_ping(port: PortHandler) -> None:
    found, result = SDK.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert found == {2: [MUSCLE, 1], 3: [MUSCLE, 1], 100: [JOINT, 1]}


def test_read_and_write(port: PortHandler) -> None:
    assert SDK.read1ByteTxRx(port, 2, 7) == (2, COMM_SUCCESS, 0)
    assert SDK.read2ByteTxRx(port, 2, 708) == (15_000, COMM_SUCCESS, 0)
    assert SDK.read4ByteTxRx(port, 100, 740) == (250_000, COMM_SUCCESS, 0)
    assert SDK.write1ByteTxRx(port, 2, 65, 1) == (COMM_SUCCESS, 0)
    assert SDK.write2ByteTxRx(port, 2, 722, 20_000) == (COMM_SUCCESS, 0)
    assert SDK.write4ByteTxRx(port, 2, 724, 123_456) == (COMM_SUCCESS, 0)
    assert SDK.read1ByteTxRx(port, 2, 65)[0] == 1
    assert SDK.read2ByteTxRx(port, 2, 722)[0] == 20_000
    assert SDK.read4ByteTxRx(port, 2, 724)[0] == 123_456


@pytest.mark.parametrize(
    ("address", "value", "error"), [(70, 0, 7), (65, 2, 6), (720, 1, 5), (300, 0, 7)]
)
def test_status_errors(port: PortHandler, address: int, value: int, error: int) -> None:
    assert SDK.write1ByteTxRx(port, 2, address, value) == (COMM_SUCCESS, error)


def test_alert(port: PortHandler, chain: Chain) -> None:
    module = chain.modules[0]
    assert isinstance(module, MuscleModule)
    module.bank.hardware_error[0] = 4
    _, result, error = SDK.ping(port, 2)
    assert result == COMM_SUCCESS
    assert "Hardware error" in SDK.getRxPacketError(error)


@pytest.mark.parametrize("fast", [False, True])
def test_sync_read(port: PortHandler, fast: bool) -> None:
    group = GroupSyncRead(port, SDK, 740, 9)
    for module_id in (3, 100, 2):
        assert group.addParam(module_id)
    assert (group.fastSyncRead() if fast else group.txRxPacket()) == COMM_SUCCESS
    assert group.getData(100, 740, 4) == 250_000
    assert [group.getData(i, 746, 2) for i in (2, 3)] == [250, 250]  # 25.0 degC


def test_sync_write(port: PortHandler, chain: Chain) -> None:
    group = GroupSyncWrite(port, SDK, 720, 8)
    for module_id in (2, 3):
        assert group.addParam(module_id, [module_id, 0, 0x20, 0x4E, 1, 2, 3, 4])
    assert group.txPacket() == COMM_SUCCESS
    for module_id in (2, 3):
        assert SDK.read2ByteTxRx(port, module_id, 720) == (module_id, COMM_SUCCESS, 0)
        assert SDK.read4ByteTxRx(port, module_id, 724) == (0x04030201, COMM_SUCCESS, 0)


@pytest.mark.parametrize("fast", [False, True])
def test_bulk(port: PortHandler, fast: bool) -> None:
    write = GroupBulkWrite(port, SDK)
    assert write.addParam(2, 65, 1, [1])
    assert write.addParam(3, 722, 2, [0x20, 0x4E])
    assert write.txPacket() == COMM_SUCCESS
    read = GroupBulkRead(port, SDK)
    assert read.addParam(3, 722, 2)
    assert read.addParam(2, 65, 1)
    assert (read.fastBulkRead() if fast else read.txRxPacket()) == COMM_SUCCESS
    assert read.getData(3, 722, 2) == 20_000
    assert read.getData(2, 65, 1) == 1


def test_registered_write(port: PortHandler) -> None:
    assert SDK.regWriteTxRx(port, 2, 65, 1, [1]) == (COMM_SUCCESS, 0)
    assert SDK.read1ByteTxRx(port, 2, 65)[0] == 0
    assert SDK.action(port, BROADCAST_ID) == COMM_SUCCESS
    assert SDK.read1ByteTxRx(port, 2, 65)[0] == 1


def test_reboot_and_factory_reset(port: PortHandler) -> None:
    SDK.write1ByteTxRx(port, 2, 65, 1)
    assert SDK.reboot(port, 2) == (COMM_SUCCESS, 0)
    assert SDK.read1ByteTxRx(port, 2, 65)[0] == 0
    assert SDK.factoryReset(port, 3, 0x02) == (COMM_SUCCESS, 0)
    assert SDK.ping(port, 3) == (MUSCLE, COMM_SUCCESS, 0)


def test_new_id(port: PortHandler) -> None:
    assert SDK.write1ByteTxRx(port, 3, 7, 40) == (COMM_SUCCESS, 0)
    assert SDK.ping(port, 40) == (MUSCLE, COMM_SUCCESS, 0)


def test_wrong_checksum(port: PortHandler, chain: Chain) -> None:
    port.writePort(bytes.fromhex("fffffd00 02 0300 01 1973"))  # a ping of 2 ends in 1972
    assert SDK.ping(port, 2) == (MUSCLE, COMM_SUCCESS, 0)  # one answer, to this ping
    assert port.getBytesAvailable() == 0
    assert chain.modules[0].link_errors == 1


@pytest.mark.parametrize("value", [0x00FDFFFF, 0x01FDFFFF, 0x7DFDFFFF])
def test_byte_stuffing(port: PortHandler, value: int) -> None:
    """FF FF FD in a value is no header, both ways.

    The request is put together here: the Python client 4.1.0 leaves out stuffing when it sends,
    as `addStuffing` changes a copy. It takes stuffing out of what it receives.
    """
    top = value >> 24
    request = [*bytes.fromhex("fffffd00 02 0a00 03 d402 fffffdfd"), top]
    crc = SDK.updateCRC(0, request, len(request))
    port.writePort(bytes((*request, crc & 0xFF, crc >> 8)))
    port.setPacketTimeoutMillis(2000)  # a busy machine is slower than the line
    assert SDK.readRx(port, 2, 0)[1:] == (COMM_SUCCESS, 0)
    assert SDK.read4ByteTxRx(port, 2, 724) == (value, COMM_SUCCESS, 0)


def test_client_may_come_and_go(chain: Chain) -> None:
    with PtyChain(chain) as terminal:
        for _ in range(2):
            port = PortHandler(terminal.path)
            assert port.setBaudRate(BAUD)
            assert SDK.ping(port, 2) == (MUSCLE, COMM_SUCCESS, 0)
            port.closePort()
    terminal.close()
