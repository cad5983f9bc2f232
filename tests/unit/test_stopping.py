"""A chain stops, stays stopped whatever comes, and is reset."""

from __future__ import annotations

import pytest

from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.wire import packet as wire
from tests.unit.driver_bench import PRELOAD_N, Bench

K = 20_000.0


def test_a_stop_goes_out_at_once_and_is_latched_in_every_module(bench: Bench) -> None:
    bench.run(0.002)  # between two cycles
    before = len(bench.requests)
    reply = bench.ask(m.Estop(reason="test"))
    assert reply.ok
    assert wire.encode(wire.sync_write(719, 1, {2: b"\1", 3: b"\1"})) in bench.requests[before].data
    assert all(bench.bank.stop)
    assert bench.driver.mode == "stopping"
    bench.run(0.01)
    assert bench.states[-1].mode == "stopping"
    assert "stopped" not in bench.kinds()
    asked_ns = bench.now_ns
    bench.run_until(lambda: "stopped" in bench.kinds())
    assert bench.now_ns - asked_ns > 0.25e9  # the wires have been slack for a while
    assert bench.states[-1].mode == "stopped"
    assert max(bench.states[-1].tension_n) < 5.0
    assert bench.info("m2").state == "stopped"


def test_a_stop_lost_on_the_line_is_said_again(bench: Bench) -> None:
    bench.chain.faults.set("drop", "arm", 1.0)
    bench.ask(m.Estop())
    bench.run(0.02)
    assert not any(bench.bank.stop)
    bench.chain.faults.clear("drop", "arm")
    bench.run(0.02)
    assert all(bench.bank.stop)


def test_nothing_moves_a_stopped_chain(bench: Bench) -> None:
    bench.ask(m.Estop())
    bench.run(2.0)
    for _ in range(20):
        bench.command(m2=(60.0, 0.0, 0.0))
        bench.run(0.01)
    assert bench.states[-1].mode == "stopped"
    assert max(bench.states[-1].tension_n) < 5.0


def test_a_restarted_driver_stays_stopped(bench: Bench) -> None:
    bench.ask(m.Estop())
    bench.run(2.0)
    bench.events.clear()
    bench.new_driver()
    bench.run(0.5)
    assert bench.states[-1].mode == "stopped"
    assert "stopped" in bench.kinds()
    assert all(bench.bank.stop)


def test_a_driver_without_memory_learns_of_the_stop_from_the_modules(bench: Bench) -> None:
    bench.ask(m.Estop())
    bench.run(2.0)
    bench.store = MemoryStore()
    bench.new_driver()
    bench.run(0.5)
    assert bench.states[-1].mode == "stopped"


def test_a_module_that_was_away_at_the_reset_lets_go_when_it_is_back(bench: Bench) -> None:
    bench.ask(m.Estop())
    bench.run(2.0)
    bench.chain.faults.set("drop", "m2", 1.0)
    bench.run_until(lambda: "lost" in bench.kinds())
    assert bench.ask(m.Reset()).ok
    bench.run(0.1)
    bench.chain.faults.clear("drop", "m2")
    bench.run_until(lambda: "returned" in bench.kinds())
    bench.run(0.2)
    assert bench.driver.mode in ("hold", "follow")
    assert not any(bench.bank.stop)


def test_a_reset_holds_where_the_arm_is(bench: Bench) -> None:
    bench.ask(m.Estop())
    bench.run(2.0)
    length = bench.felt("m2")[0]
    assert bench.ask(m.Reset()).ok
    bench.run(1.0)
    assert not any(bench.bank.stop)
    assert bench.states[-1].mode == "hold"
    assert bench.felt("m2")[0] == pytest.approx(length, abs=0.001)
    assert bench.felt("m2")[1] < 6.0
    length = bench.felt("m2")[0]
    for _ in range(30):
        bench.command(m2=(20.0, K, length))
        bench.run(0.01)
    assert bench.felt("m2")[1] > 8.0


def test_a_stop_that_reaches_nobody_is_no_success() -> None:
    bench = Bench()
    bench.tamper = lambda reply: None
    bench.run(0.1)
    reply = bench.ask(m.Estop())
    assert not reply.ok
    assert "no muscle answers" in reply.text
    bench.tamper = None
    bench.run(1.0)
    assert all(bench.bank.stop)  # but it stands for whoever comes


def test_a_reset_when_nothing_was_stopped_does_no_harm(bench: Bench) -> None:
    assert bench.ask(m.Reset()).ok
    bench.run(0.1)
    assert bench.felt("m2")[1] == pytest.approx(PRELOAD_N, abs=0.5)
