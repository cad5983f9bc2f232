"""A simulated robot's chains as pseudo-terminals: real processes, real terminals."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from hardware_sim.terminals import main
from runtime import messages as m
from runtime.wire import packet as wire
from runtime.wire.link import SerialLink, parse_link
from runtime.wire.registers import BY_NAME
from tests.started import started

PATIENCE_S = 30.0


def ask(link: SerialLink, packet: wire.InstructionPacket, sequence: int) -> bytes:
    request = m.BusRequest(chain="arm", sequence=sequence, data=wire.encode(packet))
    (status,) = wire.Decoder().feed(link.exchange(request).data)
    return status.params


def test_a_chain_is_opened_like_a_serial_port_and_its_robot_lives(tmp_path: Path) -> None:
    folder = tmp_path / "chains"
    folder.mkdir()
    (folder / "arm").symlink_to("/dev/pts/of_a_run_that_was_killed")
    with started("-m", "hardware_sim.terminals", "elbow", "--folder", str(folder)) as robot:
        assert robot.stdout is not None
        url = robot.stdout.readline().split('"')[1]
        assert url == f"serial://{folder}/arm"
        port = parse_link(url)
        assert port is not None
        link = SerialLink(port, timeout_s=PATIENCE_S)
        assert ask(link, wire.ping(2), 1)[:2] == b"1M"
        temperature = BY_NAME["motor_temperature"]
        read = wire.read(2, temperature.address, temperature.size)
        assert temperature.decode(ask(link, read, 2)) > 0.0
        angle = BY_NAME["present_angle"]
        first = ask(link, wire.read(100, angle.address, angle.size), 3)
        sequence, deadline_s = 4, time.monotonic() + PATIENCE_S
        # a sensor that lives is noisy
        while ask(link, wire.read(100, angle.address, angle.size), sequence) == first:
            assert time.monotonic() < deadline_s, "robot time stands still"
            sequence += 1
        link.close()
        robot.send_signal(signal.SIGINT)
        assert robot.wait(PATIENCE_S) == 0
    assert list(folder.iterdir()) == []


def test_a_file_in_the_way_is_left_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm").write_text("mine")
    assert main(["elbow", "--folder", str(tmp_path)]) == 2
    assert "File exists" in capsys.readouterr().err
    assert (tmp_path / "arm").read_text() == "mine"


def test_a_robot_that_is_not_there_is_told_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["elbwo", "--folder", str(tmp_path)]) == 2
    assert "did you mean" in capsys.readouterr().err
