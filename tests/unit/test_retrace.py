"""A recording led through a logic again: the same to the last bit, or a report of what differs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import msgspec
import pytest

from runtime import messages as m
from runtime.cli.replay import report_text
from runtime.journal import Entry
from runtime.messages import Message, Reply
from runtime.retrace import Report, logics, retrace
from runtime.steps import EVERY_NS, StepLog
from runtime.topics import key_of

ROBOT = "elbow"
TICK_NS = 5_000_000
RUN_NS = 4 * EVERY_NS


class Summing:
    """Publishes, once a tick, the sum of all lengths that it has heard."""

    inputs: tuple[type[Message], ...] = (m.ChainState,)
    requests: tuple[type[Message], ...] = ()
    outputs: tuple[type[Message], ...] = (m.JointEstimate,)
    period_ns = TICK_NS

    def __init__(self, gain: float = 1.0) -> None:
        self.sum = 0.0
        self.gain = gain

    def receive(self, message: Message, now_ns: int) -> None:
        assert isinstance(message, m.ChainState)
        if message.mode == "bad":
            raise ValueError("bad")
        self.sum += self.gain * message.length_m[0]

    def answer(self, request: Message, now_ns: int) -> Reply:
        return Reply(ok=False)

    def tick(self, now_ns: int) -> Iterable[Message]:
        yield m.JointEstimate(
            stamp_ns=now_ns,
            joints=("elbow",),
            angle_rad=(self.sum, math.nan),
            confidence_rad=(),
            muscles=(),
            predicted_length_m=(),
            predicted_tension_n=(),
            anomaly=(),
        )


class Newest(Summing):
    """Publishes the newest length alone, and nothing when there is none."""

    def receive(self, message: Message, now_ns: int) -> None:
        self.sum = 0.0
        super().receive(message, now_ns)

    def tick(self, now_ns: int) -> Iterable[Message]:
        if self.sum:
            yield from super().tick(now_ns)
        self.sum = 0.0


def state(stamp_ns: int, mode: str = "follow") -> m.ChainState:
    return m.ChainState(
        stamp_ns=stamp_ns,
        chain="arm",
        muscles=("biceps",),
        length_m=(math.sin(stamp_ns),),
        tension_n=(1.0,),
        temperature_degc=(25.0,),
        target_length_m=(0.0,),
        mode=mode,
    )


def recorded(
    starts: int = 1,
    heard: Callable[[int], bool] = lambda n: n % 3 > 0,
    make: Callable[[], Summing] = Summing,
) -> list[Entry]:
    """A live run as the recorder has it: each third state is overwritten before it is heard."""
    messages: list[Message] = []
    now_ns = 0
    for _ in range(starts):
        logic, steps = make(), StepLog(ROBOT, "adder")
        for n in range(RUN_NS // TICK_NS):
            now_ns += TICK_NS
            told = state(now_ns, "bad" if n == 7 else "follow")
            messages.append(told)
            if heard(n):
                steps.take(told)
                if told.mode != "bad":
                    logic.receive(told, now_ns)
            messages += logic.tick(now_ns)
            if (summary := steps.act(now_ns)) is not None:
                messages.append(summary)
        if (rest := steps.rest()) is not None:
            messages.append(rest)
    return [Entry(n, key_of(ROBOT, message), message) for n, message in enumerate(messages)]


def check(entries: list[Entry], gain: float = 1.0) -> Report:
    return retrace("adder", lambda: Summing(gain), entries)


def without(entries: list[Entry], lost: Callable[[Message], bool]) -> list[Entry]:
    return [entry for entry in entries if not lost(entry.message)]


@pytest.mark.parametrize("starts", [1, 3])
def test_the_same_logic_gives_the_same_to_the_last_bit(starts: int) -> None:
    report = check(recorded(starts))
    assert report.exact
    assert report.within(0.0)
    assert report.compared == starts * RUN_NS // TICK_NS
    assert (report.begin_ns, report.end_ns) == (TICK_NS, starts * RUN_NS)
    assert "to the last bit" in report_text(report)


def test_what_is_written_late_is_heard_all_the_same() -> None:
    """The recorder has no order between processes: steps may be there before what they name."""
    entries = recorded()
    late = [i for i, entry in enumerate(entries) if isinstance(entry.message, m.Steps)]
    for i in late:
        entries[i - 6 : i + 1] = [entries[i], *entries[i - 6 : i]]
    assert check(entries).exact


def test_what_is_written_seconds_late_is_heard_all_the_same() -> None:
    """A recorder that came up late has what is retained from who keeps it."""
    entries = recorded(starts=3)
    _, second, *_ = (n for n, x in enumerate(entries) if isinstance(x.message, m.ChainState))
    told = entries.pop(second)
    assert check([*entries, told]).exact
    assert check(entries).unheard == 1


def test_what_a_second_recorder_was_told_again_counts_once() -> None:
    entries = recorded()
    (first, *_) = (n for n, x in enumerate(entries) if isinstance(x.message, m.Steps))
    assert check([*entries[: first + 300], entries[first], *entries[first + 300 :]]).exact


def test_two_of_one_stamp_are_told_apart() -> None:
    """Robot time may stand still where a machine is too slow."""
    messages: list[Message] = []
    logic, steps = Summing(), StepLog(ROBOT, "adder")
    for length_m in (1.0, 2.0, 3.0):
        told = msgspec.structs.replace(state(TICK_NS), length_m=(length_m,))
        steps.take(told)
        logic.receive(told, TICK_NS)
        messages += [told, *logic.tick(TICK_NS)]
        assert steps.act(TICK_NS) is None
    rest = steps.rest()
    assert rest is not None
    messages.append(rest)
    report = check([Entry(n, key_of(ROBOT, x), x) for n, x in enumerate(messages)])
    assert report.exact
    assert report.compared == 3


def test_a_changed_logic_is_found_out_field_by_field() -> None:
    report = check(recorded(), gain=1.0 + 1e-9)
    assert not report.exact
    assert not report.within(1e-12)
    assert report.within(1e-6)
    assert set(report.differences) == {"JointEstimate.angle_rad"}
    worst = report.differences["JointEstimate.angle_rad"]
    assert 0.0 < worst.greatest < 1e-6
    assert worst.messages == report.compared - report.equal
    assert f"differs in {worst.messages}" in report_text(report)


def test_what_cannot_be_subtracted_differs_infinitely() -> None:
    entries = recorded()
    for i, entry in enumerate(entries):
        if isinstance(entry.message, m.JointEstimate):
            entries[i] = entry._replace(message=msgspec.structs.replace(entry.message, joints=()))
    report = check(entries)
    assert report.equal == 0
    assert report.differences["JointEstimate.joints"].greatest == math.inf
    assert not report.within(1e9)


def test_what_the_recording_lacks_is_counted() -> None:
    entries = recorded()
    half_ns = RUN_NS // 2

    def early_state(message: Message) -> bool:
        return isinstance(message, m.ChainState) and message.stamp_ns < 10 * TICK_NS

    assert check(without(entries, early_state)).unheard == 6

    some = check(without(entries, lambda x: isinstance(x, m.JointEstimate) and x.stamp_ns < 50e6))
    assert (some.invented, some.silent, some.exact) == (9, 0, False)

    more = msgspec.structs.replace(Summing().tick(0).__next__(), stamp_ns=half_ns + 1)  # type: ignore[attr-defined]
    odd = check([Entry(0, key_of(ROBOT, more), more), *entries])
    assert (odd.silent, odd.exact) == (1, False)

    torn = check(without(entries, lambda x: isinstance(x, m.Steps) and x.stamp_ns > half_ns))
    assert torn.exact
    assert torn.untold > 0

    holed = check(without(entries, lambda x: isinstance(x, m.Steps) and 0 < x.begin < 150))
    assert holed.lost_steps == 100
    assert 100 < holed.left_out < 130
    assert (holed.silent, holed.untold) == (0, 0)
    assert not holed.exact, "its sum lacks what it heard meanwhile"
    assert "the recording has gaps, 0.3-0.9 s" in report_text(holed)

    twice = recorded(2)
    starts = [
        n for n, x in enumerate(twice) if isinstance(x.message, m.Steps) and not x.message.begin
    ]
    anew = check([entry for n, entry in enumerate(twice) if n != starts[1]])
    assert anew.lost_steps > 0, "it was started anew, and the first of its steps are not on record"
    assert anew.silent == 0
    assert anew.started_ns == [twice[starts[1]].message.stamp_ns + TICK_NS]
    assert "the process was started anew at 1.3 s" in report_text(anew)

    nothing = check(without(entries, lambda x: isinstance(x, m.Steps)))
    assert not nothing.exact
    assert "not on record" in report_text(nothing)


def test_gaps_are_no_fault_of_a_logic_that_forgets() -> None:
    """The recorder heard nothing for a while, or did not hear who is listened to."""
    entries = recorded(make=Newest)
    for kinds in ((m.ChainState,), (m.ChainState, m.Steps, m.JointEstimate)):

        def deaf(message: Message, kinds: tuple[type, ...] = kinds) -> bool:
            return isinstance(message, kinds) and 0.3e9 < message.stamp_ns < 0.6e9

        report = retrace("adder", Newest, without(entries, deaf))
        assert report.exact and report.left_out > 0
        (gap,) = report.gaps
        assert gap.begin_ns == pytest.approx(0.3e9, abs=0.06e9)
        assert gap.end_ns == pytest.approx(0.6e9, abs=0.26e9)
        assert "the recording has gaps, 0.3-" in report_text(report)
        changed = retrace("adder", lambda: Newest(1.1), without(entries, deaf))
        assert not changed.exact


def test_an_output_that_is_written_late_is_compared_all_the_same() -> None:
    entries = recorded()
    (first, *_) = (n for n, x in enumerate(entries) if isinstance(x.message, m.JointEstimate))
    assert check([*entries[:first], *entries[first + 1 :], entries[first]]).exact


def test_steps_that_do_not_fit_are_as_if_they_were_not_there() -> None:
    steps = m.Steps(
        process="adder",
        begin=0,
        tick_ns=(5,),
        taken=(1,),
        keys=("chain/arm/state",),
        heard_key=(0,),
        heard_ns=(5,),
    )
    odd = [{"taken": (2,)}, {"taken": (-1,)}, {"heard_key": (1,)}, {"tick_ns": ()}, {"keys": ()}]
    entries = [Entry(0, "", msgspec.structs.replace(steps, **fields)) for fields in odd]
    assert check([*entries, *recorded()]).exact


def test_the_estimator_can_be_retraced() -> None:
    assert m.JointEstimate in logics()["estimator"].outputs  # type: ignore[attr-defined]
