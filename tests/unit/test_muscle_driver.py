"""The driver on a real chain of firmware twins: readings, commands, limits, restart."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import pytest

from runtime import messages as m
from runtime.wire.registers import BY_NAME, Status
from services.logic.command_gate import OFTEN
from services.logic.muscle_driver import MuscleDriver
from tests.unit.driver_bench import MS, PRELOAD_N, SETTINGS, Bench

K = 20_000.0


def test_meets_the_modules_of_the_robot_file(bench: Bench) -> None:
    infos = bench.bodies[-1].modules
    assert [(x.name, x.kind, x.module_id, x.serial, x.state) for x in infos] == [
        ("m2", "muscle", 2, 1002, "up"),
        ("m3", "muscle", 3, 1003, "up"),
        ("elbow", "joint", 100, 9, "up"),
    ]
    assert infos[0].tension_limit_n == SETTINGS.module.tension_limit_n


def test_tells_readings_with_the_time_of_the_request(bench: Bench) -> None:
    before = len(bench.states)
    bench.run(0.1)
    news = bench.states[before:]
    assert len(news) == 20
    assert [b.stamp_ns - a.stamp_ns for a, b in pairwise(news)] == [5 * MS] * 19
    assert bench.now_ns - news[-1].stamp_ns <= 5 * MS
    assert news[-1].muscles == ("m2", "m3")
    assert bench.joints[-1].joints == ("elbow",)
    assert bench.joints[-1].angle_rad == pytest.approx((0.5,))
    assert bench.joints[-1].stamp_ns == news[-1].stamp_ns


def test_holds_what_the_brakes_held_when_it_starts(bench: Bench) -> None:
    assert all(bench.module(name).read(64, 1) == b"\1" for name in ("m2", "m3"))
    assert all(
        tension == pytest.approx(PRELOAD_N, abs=0.5)
        for state in bench.states
        for tension in state.tension_n
    )
    assert bench.states[-1].mode == "hold"


def test_follows_a_command(bench: Bench) -> None:
    length, tension, _ = bench.felt("m2")
    for _ in range(100):
        bench.command(m2=(10.0, K, length - 0.002))
        bench.run(0.01)
    assert bench.states[-1].mode == "follow"
    # 10 + K (l - target) against a wire of K: half of the stretch is given up
    assert bench.felt("m2")[1] == pytest.approx((tension + 10.0 + 0.002 * K) / 2, abs=1.0)
    assert bench.felt("m3")[1] == pytest.approx(PRELOAD_N, abs=0.5)  # not named: holds


def test_targets_move_no_faster_than_the_motor_winds(bench: Bench) -> None:
    length, _, _ = bench.felt("m2")
    bench.command(m2=(5.0, K, length))
    bench.run(0.1)
    for _ in range(20):
        bench.command(m2=(5.0, K, length + 0.05))
        bench.run(0.01)
    targets = [state.target_length_m[0] for state in bench.states]
    steps = [abs(b - a) for a, b in pairwise(targets)]
    assert max(steps) <= SETTINGS.module.winding_speed_m_s * 0.005 + 1e-9
    assert targets[-1] > length + 0.03


def test_another_stiffness_begins_at_the_tension_that_was_asked_for(bench: Bench) -> None:
    length, tension, _ = bench.felt("m2")
    peak = bench.bank.peak_target_speed_m_s[0]
    bench.command(m2=(10.0, K / 2, length - (tension - 10.0) / (K / 2)))
    start = len(bench.states)
    bench.run(0.1)
    assert all(x.tension_n[0] == pytest.approx(tension, abs=1.0) for x in bench.states[start:])
    assert bench.bank.peak_target_speed_m_s[0] >= peak


def test_holds_when_the_lease_runs_out(bench: Bench) -> None:
    length, _, _ = bench.felt("m2")
    bench.command(m2=(5.0, K, length + 1.0))
    bench.run(0.15)
    assert bench.states[-1].mode == "follow"
    bench.run(0.06)
    assert bench.states[-1].mode == "hold"
    frozen = bench.felt("m2")[2]
    bench.run(0.5)
    assert bench.felt("m2")[2] == frozen


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"author": "somebody"}, "only 'executive'"),
        ({"stamp_ns": -150 * MS}, "more than 100 ms old: the machine was too slow"),
        ({"stamp_ns": 150 * MS}, "in the future"),
        ({"stamp_ns": -20 * MS}, "newer"),
        ({"lease_ns": 0}, "lease"),
        ({"bias_n": ()}, "one value for each"),
        ({"bias_n": (float("nan"),)}, "no numbers"),
        ({"target_length_m": (1e6,)}, "beyond"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_refuses_and_says_so_once(bench: Bench, changes: dict[str, object], word: str) -> None:
    length, _, target = bench.felt("m2")
    bench.command()  # one that counts and wants nothing
    bench.run(0.01)
    command = bench.make_command(m2=(60.0, K, length))
    if "stamp_ns" in changes:
        changes = {"stamp_ns": bench.now_ns + int(str(changes["stamp_ns"]))}
    for _ in range(5):
        bench.send(msgspec.structs.replace(command, **changes))
        bench.run(0.01)
    assert bench.felt("m2")[2] == target
    event = bench.event("command_refused")
    assert word in event.text
    assert (event.level == "info") == ("stamp_ns" in changes and word != "newer")


def test_many_late_commands_are_worth_a_warning(bench: Bench) -> None:
    for _ in range(OFTEN):
        late = bench.make_command(m2=(60.0, K, 0.0))
        bench.send(msgspec.structs.replace(late, stamp_ns=bench.now_ns - 150 * MS))
        bench.run(0.01)
    told = [event for event in bench.events if event.kind == "command_refused"]
    assert [event.level for event in told] == ["info", "warning"]
    assert told[-1].text.startswith("command number 100 of 'executive'")


def test_muscles_it_does_not_know_are_left_aside(bench: Bench) -> None:
    bench.command(nobody=(60.0, K, 0.0), m2=(5.0, K, bench.felt("m2")[0]))
    bench.run(0.1)
    assert bench.states[-1].mode == "follow"
    assert bench.events == []


# ── a line that is not clean ──────────────────────────────────────────────────────────────────


def test_one_corrupt_answer_costs_one_sample_of_one_module(bench: Bench) -> None:
    bench.path_m[0] += 0.0005  # both tensions rise, so that a new reading differs
    bench.path_m[1] += 0.0005
    before = len(bench.states)

    def flip(reply: m.BusReply) -> m.BusReply:
        data = bytearray(reply.data)
        if len(data) > 40:
            bench.tamper = None
            data[10] ^= 0x10
        return msgspec.structs.replace(reply, data=bytes(data))

    old = bench.states[-1]
    bench.tamper = flip
    bench.run(0.011)
    first, second = bench.states[before : before + 2]
    assert first.tension_n[0] == old.tension_n[0]
    assert first.tension_n[1] > old.tension_n[1] + 3.0
    assert second.tension_n[0] > old.tension_n[0] + 3.0
    bench.run(1.0)
    assert (bench.info("m2").link_errors, bench.info("m3").link_errors) == (1, 0)
    assert bench.events == []


def test_a_noisy_line_costs_samples_and_nothing_else(bench: Bench) -> None:
    bench.chain.faults.set("corrupt", "arm", 5e-4)
    before = len(bench.states)
    bench.run(5.0)
    assert len(bench.states) - before > 950
    assert bench.info("m2").link_errors > 5
    assert "lost" not in bench.kinds()
    assert bench.felt("m2")[1] == pytest.approx(PRELOAD_N, abs=1.0)


def test_replies_in_pieces_and_late_ones_find_their_cycle(bench: Bench) -> None:
    held: list[m.BusReply] = []

    def hold_back(reply: m.BusReply) -> None:
        held.append(reply)

    bench.tamper = hold_back
    before = len(bench.states)
    bench.run(0.005)
    asked_ns = bench.now_ns
    bench.tamper = None
    (late,) = [reply for reply in held if len(reply.data) > 40]
    bench.driver.receive(msgspec.structs.replace(late, data=late.data[:25]), bench.now_ns)
    bench.driver.receive(msgspec.structs.replace(late, data=late.data[25:]), bench.now_ns)
    bench.driver.receive(msgspec.structs.replace(late, sequence=7), bench.now_ns)  # nobody's
    bench.run(0.005)
    assert [state.stamp_ns for state in bench.states[before:]] == [asked_ns, asked_ns + 5 * MS]
    assert bench.info("m2").link_errors == 0


def test_a_module_that_falls_silent_is_lost_and_the_others_go_on(bench: Bench) -> None:
    m2 = bench.module("m2")
    bench.chain.modules.remove(m2)
    bench.run(0.04)
    assert bench.states[-1].muscles == ("m2", "m3")
    bench.run(0.03)
    assert bench.states[-1].muscles == ("m3",)
    assert bench.info("m2").state == "lost"
    assert bench.event("lost").data["muscle"] == "m2"
    before = len(bench.states)
    bench.run(0.1)
    assert len(bench.states) - before == 20


def test_a_short_dropout_is_taken_over_without_winding_in(bench: Bench) -> None:
    m2 = bench.module("m2")
    bench.chain.modules.remove(m2)
    bench.run(0.08)
    bench.chain.modules.append(m2)
    bench.run_until(lambda: bench.states[-1].muscles == ("m2", "m3"), 1.0)
    assert bench.kinds() == ["lost", "returned"]
    bench.run(0.2)
    assert bench.felt("m2")[1] == pytest.approx(PRELOAD_N, abs=1.0)


def test_nobody_is_lost_while_the_whole_line_is_away_for_a_moment(bench: Bench) -> None:
    bench.tamper = lambda reply: None
    before = len(bench.states)
    bench.run(0.1)
    assert len(bench.states) == before  # no old readings under new stamps
    bench.tamper = None
    bench.run(0.1)
    assert bench.states[-1].muscles == ("m2", "m3")
    assert "lost" not in bench.kinds()


def test_says_so_when_the_whole_chain_is_dead_and_comes_back(bench: Bench) -> None:
    bench.tamper = lambda reply: None
    bench.run(0.5)
    assert bench.kinds() == ["chain_silent", "lost", "lost", "lost"]
    bench.tamper = None
    bench.run(1.0)
    assert bench.states[-1].muscles == ("m2", "m3")
    assert bench.felt("m2")[1] == pytest.approx(PRELOAD_N, abs=1.0)


def test_waits_for_a_chain_that_is_not_there_yet() -> None:
    bench = Bench()
    bench.tamper = lambda reply: None
    bench.run(2.0)
    assert bench.kinds() == ["chain_silent"]
    assert (bench.states, bench.bodies) == ([], [])
    assert bench.now_ns - bench.requests[-1].stamp_ns <= 5 * MS  # the line hears from its master
    bench.tamper = None
    bench.run(0.5)
    assert bench.states[-1].muscles == ("m2", "m3")


# ── limits ────────────────────────────────────────────────────────────────────────────────────


def test_pays_out_while_tension_is_above_the_limit() -> None:
    module = msgspec.structs.replace(SETTINGS.module, tension_limit_n=50.0)
    bench = Bench(msgspec.structs.replace(SETTINGS, module=module))
    bench.run(0.3)
    target = bench.felt("m2")[2]
    bench.path_m[0] += 0.003  # 60 N more
    bench.run(0.05)
    assert bench.felt("m2")[2] > target + 0.0005
    bench.run(0.5)
    assert bench.felt("m2")[1] < 50.0
    assert bench.event("tension_limited").data["muscle"] == "m2"


def test_bias_above_the_limit_is_cut(bench: Bench) -> None:
    bench.command(m2=(400.0, 0.0, 0.0))
    bench.run(0.1)
    assert bench.felt("m2")[1] < SETTINGS.module.tension_limit_n


def test_an_overheated_muscle_gives_up_tension_and_gets_it_back(bench: Bench) -> None:
    bench.heat_degc[0] = 95.0
    for _ in range(800):
        bench.command(m2=(140.0, 0.0, 0.0))
        bench.run(0.01)
    assert bench.event("overheating").data["muscle"] == "m2"
    assert bench.felt("m2")[1] < 0.5 * SETTINGS.module.tension_limit_n
    fault = bench.event("fault")
    assert (fault.data["muscle"], fault.data["fault"]) == ("m2", "overheating")
    assert fault.text.endswith("switched off and on: myograft unplug m2 && myograft plug m2")
    assert (bench.info("m2").state, bench.info("m2").fault) == ("fault", "overheating")
    assert "m2" in bench.states[-1].muscles


def test_writes_the_limits_of_the_robot_file_into_the_modules() -> None:
    module = msgspec.structs.replace(
        SETTINGS.module, tension_limit_n=120.0, winding_speed_m_s=0.2, temperature_limit_degc=70.0
    )
    bench = Bench(msgspec.structs.replace(SETTINGS, module=module))
    bench.run(0.3)
    m2 = bench.module("m2")
    for name, value in (
        ("tension_limit", 120.0),
        ("winding_speed_limit", 0.2),
        ("temperature_limit", 70.0),
        ("bus_watchdog", 0.1),
    ):
        register = BY_NAME[name]
        assert register.decode(m2.read(register.address, register.size)) == pytest.approx(value)


def test_resumes_without_a_jump_after_the_bus_watchdog_tripped(bench: Bench) -> None:
    bench.run(0.3, driver=False)
    assert all(bench.bank.tripped)
    bench.run(0.1)
    assert not any(bench.bank.tripped)
    assert bench.event("watchdog_cleared").data == {}
    for state in bench.states:
        assert state.tension_n == pytest.approx((PRELOAD_N, PRELOAD_N), abs=1.0)
    length, tension, _ = bench.felt("m2")
    bench.command(m2=(5.0, K, length - (tension - 5.0) / K))
    bench.run(0.1)
    assert bench.felt("m2")[1] == pytest.approx(PRELOAD_N, abs=1.0)


# ── restart ───────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("away_s", [0.02, 0.5])
def test_a_restarted_driver_takes_live_modules_over_without_a_jump(
    bench: Bench, away_s: float
) -> None:
    length, _, _ = bench.felt("m2")
    for _ in range(50):
        bench.command(m2=(10.0, K, length - 0.004), m3=(10.0, K, length - 0.001))
        bench.run(0.01)
    tensions = bench.states[-1].tension_n
    assert max(tensions) > 50.0
    bench.run(away_s, driver=False)
    peak = max(bench.bank.peak_target_speed_m_s)
    bench.states.clear()
    bench.new_driver()
    bench.run(1.0)
    for state in bench.states:
        assert state.tension_n == pytest.approx(tensions, abs=1.5)
    assert max(bench.bank.peak_target_speed_m_s) <= max(peak, 0.25)
    assert all(int(mode) == Status.FOLLOWING for mode in bench.bank.mode)


def test_a_spoilt_memory_is_begun_anew(bench: Bench) -> None:
    bench.store.save("chain-arm", b"\x00rubbish")
    bench.new_driver()
    bench.run(0.3)
    assert [x.name for x in bench.bodies[-1].modules] == ["m2", "m3", "elbow"]


def test_is_deterministic() -> None:
    def requests() -> list[m.BusRequest]:
        bench = Bench()
        bench.run(0.5)
        return bench.requests

    assert requests() == requests()


def test_speaks_only_for_its_own_chain(bench: Bench) -> None:
    assert isinstance(bench.driver, MuscleDriver)
    command = msgspec.structs.replace(bench.make_command(m2=(60.0, K, 0.0)), chain="other")
    bench.send(command)
    bench.driver.receive(m.BusReply(chain="other", sequence=1, data=b"\0"), bench.now_ns)
    bench.run(0.05)
    assert bench.states[-1].mode == "hold"
    assert bench.events == []


# ── identify ──────────────────────────────────────────────────────────────────────────────────


def identify(bench: Bench, module: str) -> m.Reply:
    return bench.ask(m.Identify(chain="arm", module=module))


@pytest.mark.parametrize("module", ["m2", "elbow"])
def test_a_module_that_is_looked_for_blinks_and_stops(bench: Bench, module: str) -> None:
    (there,) = (x for x in bench.chain.modules if x.name == module)
    led = BY_NAME["led"].address
    reply = identify(bench, module)
    assert reply.ok
    assert f"id {there.id} on chain arm" in reply.text
    seen = []
    for _ in range(round(float(reply.data["blink_s"]) * 100) + 50):
        bench.run(0.01)
        seen.append(there.read(led, 1))
    changes = sum(a != b for a, b in pairwise([b"\0", *seen]))
    assert changes == 20  # ten times on and off again
    assert seen[-1] == b"\0"
    assert bench.kinds() == ["identify"]
    assert bench.event("identify").data == {"muscle": module, "id": str(there.id)}
    assert identify(bench, module).ok, "it can be looked for again"


def test_only_that_modules_led_is_lit_and_the_readings_go_on(bench: Bench) -> None:
    before = len(bench.states)
    identify(bench, "m2")
    bench.run(0.1)
    assert [x.read(BY_NAME["led"].address, 1) for x in bench.chain.modules] == [b"\1", b"\0", b"\0"]
    assert len(bench.states) - before == 20
    assert identify(bench, "m2").text == "m2 is blinking already"


def test_a_module_that_is_not_there_is_not_looked_for(bench: Bench) -> None:
    reply = identify(bench, "m9")
    assert not reply.ok
    assert reply.text == "no module 'm9' on chain arm, only m2, m3, elbow"
    bench.chain.unplug(bench.module("m3").serial)
    bench.run_until(lambda: bench.info("m3").state == "lost")
    assert identify(bench, "m3").text == "m3 does not answer on chain arm"


def test_a_module_that_goes_while_it_blinks_is_told(bench: Bench) -> None:
    identify(bench, "m3")
    bench.run(0.1)
    module = bench.module("m3")
    bench.chain.unplug(module.serial)
    bench.run_until(lambda: "identify_failed" in bench.kinds())
    assert "could not be told to blink" in bench.event("identify_failed").text
    bench.replug(module)
    bench.run_until(lambda: bench.info("m3").state == "up")
    assert identify(bench, "m3").ok


def test_it_blinks_while_it_is_stopped_and_stays_stopped(bench: Bench) -> None:
    bench.ask(m.Estop(reason="a test"))
    bench.run_until(lambda: bench.states[-1].mode == "stopped")
    assert identify(bench, "m2").ok
    bench.run(0.1)
    assert bench.module("m2").read(BY_NAME["led"].address, 1) == b"\1"
    assert bench.states[-1].mode == "stopped"
