"""Modules that come, go, come back, or should not be there."""

from __future__ import annotations

from collections import deque

import msgspec
import pytest

from hardware_sim.firmware import JointModule
from runtime import messages as m
from runtime.logic import MemoryStore
from tests.unit.driver_bench import MS, SETTINGS, Bench


def plug_m4(bench: Bench, **options: float) -> None:
    bench.plug("m4", 777, **options)  # type: ignore[arg-type]
    bench.announce("m4", 777)


def joined(bench: Bench, times: int = 1) -> bool:
    return bench.kinds().count("joined") == times


# ── fresh ─────────────────────────────────────────────────────────────────────────────────────


def test_a_fresh_module_is_named_wound_in_tared_and_zeroed(bench: Bench) -> None:
    plug_m4(bench, slack_m=0.05, cell_n=3.0)
    bench.run_until(lambda: "module_found" in bench.kinds(), 0.3)
    bench.run_until(lambda: bench.info("m4").state == "joining", 0.1)
    assert "m4" not in bench.states[-1].muscles  # its length means nothing yet
    bench.run_until(lambda: joined(bench))
    assert bench.event("joined").data == {
        "muscle": "m4",
        "id": "4",
        "serial": "777",
        "new": "true",
    }
    bench.run(0.1)
    assert (bench.info("m4").state, bench.info("m4").module_id) == ("up", 4)
    length, tension, _ = bench.felt("m4")
    assert length == pytest.approx(0.0, abs=5e-4)
    assert tension == pytest.approx(5.0, abs=0.5)  # without the 3 N of the load cell
    index = bench.module("m4").index
    assert bench.bank.tension_tare_n[index] == pytest.approx(3.0, abs=0.02)
    assert bench.bank.stiffness_n_m[index] == 0.0
    assert bench.felt("m2")[1] == pytest.approx(30.0, abs=0.5)  # the others did not notice


@pytest.mark.parametrize("waited_ms", range(0, 520, 20))
def test_on_a_slow_line_a_fresh_module_is_taken_in_once(bench: Bench, waited_ms: int) -> None:
    """Whoever looks for strangers may ask on its new id while it is just being given that."""
    under_way: deque[tuple[int, m.BusReply]] = deque()

    def late(reply: m.BusReply) -> None:
        under_way.append((bench.now_ns + 20 * MS, reply))

    bench.run(waited_ms * 1e-3)
    bench.tamper = late
    plug_m4(bench)
    while "joined" not in bench.kinds() and bench.now_ns < 6_000 * MS:
        bench.run(0.001)
        while under_way and under_way[0][0] <= bench.now_ns:
            bench.driver.receive(under_way.popleft()[1], bench.now_ns)
            bench.tick()
    assert bench.kinds() == ["module_found", "joined"]


def test_length_never_jumps_once_it_is_told(bench: Bench) -> None:
    plug_m4(bench)
    bench.run_until(lambda: joined(bench))
    bench.run(0.3)
    lengths = [
        state.length_m[state.muscles.index("m4")] for state in bench.states if "m4" in state.muscles
    ]
    assert lengths
    assert max(map(abs, lengths)) < 1e-3


def test_a_module_that_nobody_announced_is_called_by_its_serial_number(bench: Bench) -> None:
    bench.plug("m4", 777)
    bench.run(0.4)
    assert "module_found" not in bench.kinds()
    bench.run_until(lambda: joined(bench))
    assert bench.info("muscle_777").state == "up"


def test_a_name_that_is_in_use_is_not_given_twice(bench: Bench) -> None:
    bench.plug("m4", 777)
    bench.announce("m2", 777)
    bench.run_until(lambda: joined(bench))
    assert bench.event("name_taken").data["muscle"] == "m2_777"
    assert bench.info("m2").serial == 1002


def test_a_command_moves_no_muscle_that_is_still_joining(bench: Bench) -> None:
    plug_m4(bench, slack_m=0.3)
    bench.run_until(lambda: "module_found" in bench.kinds(), 0.3)
    for _ in range(50):
        bench.command(m4=(60.0, 20_000.0, -1.0))
        bench.run(0.01)
    index = bench.module("m4").index
    assert bench.bank.bias_n[index] == 5.0
    assert bench.bank.stiffness_n_m[index] == 0.0


def test_a_wire_that_stays_slack_is_a_clear_error(bench: Bench) -> None:
    plug_m4(bench, slack_m=50.0)
    bench.run_until(lambda: "join_failed" in bench.kinds(), 35.0)
    assert "check that its end is attached" in bench.event("join_failed").text
    assert bench.info("m4").state == "fault"
    assert "m4" not in bench.states[-1].muscles


def test_a_load_cell_far_off_is_a_clear_error(bench: Bench) -> None:
    plug_m4(bench, cell_n=24.0)
    bench.run_until(lambda: "join_failed" in bench.kinds(), 3.0)
    assert "load cell" in bench.event("join_failed").text
    assert not bench.bank.torque[bench.module("m4").index]


def test_a_stop_while_joining_ends_the_winding_and_a_reset_goes_on_with_it(bench: Bench) -> None:
    plug_m4(bench, slack_m=0.05)
    bench.run_until(lambda: bench.bank.torque[-1] > 0)
    bench.ask(m.Estop())
    bench.run(1.0)
    assert all(bench.bank.stop)
    assert not joined(bench)
    bench.ask(m.Reset())
    bench.run_until(lambda: joined(bench))
    assert bench.felt("m4")[0] == pytest.approx(0.0, abs=1e-3)


def test_joining_survives_a_noisy_line(bench: Bench) -> None:
    bench.chain.faults.set("corrupt", "arm", 5e-4)
    plug_m4(bench)
    bench.run_until(lambda: joined(bench), 15.0)


def test_joining_survives_a_silence_of_the_line(bench: Bench) -> None:
    plug_m4(bench, slack_m=0.05)
    bench.run_until(lambda: "module_found" in bench.kinds(), 0.3)
    bench.run(0.3)
    bench.tamper = lambda reply: None
    bench.run(0.06)
    bench.tamper = None
    bench.run_until(lambda: joined(bench), 4.0)


def test_joining_survives_a_tripped_watchdog(bench: Bench) -> None:
    plug_m4(bench, slack_m=0.05)
    bench.run_until(lambda: "module_found" in bench.kinds(), 0.3)
    bench.run(0.3)
    bench.run(0.16, driver=False)
    bench.run_until(lambda: "watchdog_cleared" in bench.kinds(), 0.5)
    bench.run_until(lambda: joined(bench), 4.0)


def test_a_fresh_joint_module_gets_an_id_of_its_own(bench: Bench) -> None:
    bench.chain.plug(JointModule(55, lambda: 0.25, 1, "wrist"))
    bench.announce("wrist", 55)
    bench.run(0.5)
    assert bench.joints[-1].joints == ("elbow", "wrist")
    assert bench.joints[-1].angle_rad == pytest.approx((0.5, 0.25))
    assert bench.info("wrist").module_id == 101


# ── coming back ───────────────────────────────────────────────────────────────────────────────


def test_a_returning_module_keeps_name_and_id_and_is_joined_anew(bench: Bench) -> None:
    plug_m4(bench)
    bench.run_until(lambda: joined(bench))
    m4 = bench.chain.unplug(777)
    bench.run(0.3)
    assert bench.info("m4").state == "lost"
    bench.replug(m4, slack_m=0.1)  # type: ignore[arg-type]
    bench.run_until(lambda: joined(bench, 2), 15.0)
    assert bench.events[-1].data["new"] == "false"
    assert "returned" in bench.kinds()
    bench.run(0.1)
    assert (bench.info("m4").module_id, bench.info("m4").state) == (4, "up")
    assert bench.felt("m4")[0] == pytest.approx(0.0, abs=5e-4)


def test_a_module_reset_to_factory_state_is_known_by_its_serial_number(bench: Bench) -> None:
    plug_m4(bench)
    bench.run_until(lambda: joined(bench))
    m4 = bench.chain.unplug(777)
    bench.run(0.3)
    m4.factory_reset(0xFF)
    bench.replug(m4)  # type: ignore[arg-type]
    bench.run_until(lambda: joined(bench, 2))
    assert bench.events[-1].data == {"muscle": "m4", "id": "4", "serial": "777", "new": "false"}


def test_a_restarted_driver_knows_the_muscle_that_was_added(bench: Bench) -> None:
    plug_m4(bench)
    bench.run_until(lambda: joined(bench))
    bench.new_driver()
    bench.run(0.5)
    # as they hang on the chain, which grew at its tail; not by their ids
    up = [x.name for x in bench.bodies[-1].modules if x.state == "up"]
    assert up == ["m2", "m3", "elbow", "m4"]
    assert bench.felt("m4")[1] == pytest.approx(5.0, abs=0.5)
    assert joined(bench, 1)


def test_a_driver_that_restarts_while_a_module_is_away_still_knows_it(bench: Bench) -> None:
    plug_m4(bench)
    bench.run_until(lambda: joined(bench))
    m4 = bench.chain.unplug(777)
    bench.new_driver()
    bench.run(0.5)
    assert bench.info("m4").state == "lost"
    bench.replug(m4)  # type: ignore[arg-type]
    bench.run_until(lambda: joined(bench, 2))
    assert bench.info("m4").module_id == 4


def test_a_new_module_may_take_the_place_of_a_lost_one(bench: Bench) -> None:
    bench.chain.unplug(1003)
    bench.run(0.3)
    bench.plug("m3", 888)
    bench.announce("m3", 888)
    bench.run_until(lambda: joined(bench))
    assert bench.info("m3").serial == 888
    assert bench.event("joined").data["new"] == "true"


def test_a_module_that_brings_an_id_of_its_own_is_found(bench: Bench) -> None:
    bench.plug("m4", 777, module_id=6)
    bench.announce("m4", 777)
    bench.run_until(lambda: joined(bench))
    assert bench.info("m4").module_id == 6


def test_a_missing_module_of_the_robot_file_is_told_and_found_later() -> None:
    bench = Bench()
    m3 = bench.chain.unplug(1003)
    bench.run(0.5)
    assert bench.event("lost").data["muscle"] == "m3"
    assert bench.info("m3").state == "lost"
    bench.chain.plug(m3)
    bench.run(0.5)
    assert set(bench.states[-1].muscles) == {"m2", "m3"}


# ── what should not be ────────────────────────────────────────────────────────────────────────


def test_two_fresh_modules_at_once_are_a_clear_error(bench: Bench) -> None:
    plug_m4(bench)
    bench.plug("m5", 778)
    bench.run(0.5)
    text = bench.event("two_fresh_modules").text
    assert "two factory-fresh modules answer on id 1 of chain arm" in text
    assert "module_found" not in bench.kinds()
    bench.chain.unplug(778)
    bench.run_until(lambda: joined(bench))
    assert bench.info("m4").state == "up"


def test_two_modules_on_one_id_are_a_clear_error(bench: Bench) -> None:
    bench.plug("twin", 777, module_id=3)
    bench.run(0.2)
    event = bench.event("duplicate_id")
    assert event.data == {"muscle": "m3", "id": "3"}
    assert "unplug" in event.text
    assert bench.info("m3").state == "fault"
    assert bench.states[-1].muscles == ("m2",)  # the others go on
    bench.chain.unplug(777)
    bench.run(0.5)
    assert bench.info("m3").state == "up"
    assert bench.kinds() == ["duplicate_id", "returned"]


def test_a_full_chain_takes_nobody_in() -> None:
    chain = msgspec.structs.replace(SETTINGS.chain[0], max_modules=3)
    bench = Bench(msgspec.structs.replace(SETTINGS, chain=(chain,)))
    bench.run(0.3)
    plug_m4(bench)
    bench.run(1.0)
    assert "3 modules" in bench.event("chain_full").text
    assert bench.module("m4").id == 1
    assert not bench.bank.torque[bench.module("m4").index]


def test_a_device_that_is_no_module_is_left_alone(bench: Bench) -> None:
    foreign = JointModule(55, lambda: 0.0, 1, "foreign")
    foreign.ping = lambda: b"\x06\x04\x26"  # type: ignore[method-assign]
    bench.chain.plug(foreign)
    bench.run(0.3)
    assert "0x0406" in bench.events[-1].text
    assert foreign.id == 1


def test_an_announcement_that_makes_no_sense_is_left_aside(bench: Bench) -> None:
    for data in ({}, {"chain": "arm"}, {"chain": "arm", "serial": "x", "muscle": "m4"}):
        event = m.Event(process="world", level="info", kind="plugged", text="", data=data)
        bench.driver.receive(event, bench.now_ns)
    bench.run(0.1)
    assert bench.events == []


def test_a_memory_of_a_muscle_that_the_robot_file_calls_otherwise_wins() -> None:
    store = MemoryStore()
    bench = Bench()
    bench.store = store
    bench.new_driver()
    bench.run(0.3)
    renamed = msgspec.structs.replace(SETTINGS.muscle[0], name="other")
    bench.settings = msgspec.structs.replace(SETTINGS, muscle=(renamed, SETTINGS.muscle[1]))
    bench.new_driver()
    bench.run(0.3)
    assert bench.info("m2").serial == 1002
