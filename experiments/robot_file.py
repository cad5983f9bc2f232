"""The text of a new robot's file, with a word on everything that a person may want to change."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from experiments.proposal import FIRST_JOINT_ID, FIRST_MUSCLE_ID, Array, Limits, Line
from experiments.spare import Help
from runtime.messages import Place


def robot_file(
    name: str,
    body: str,
    chains: Sequence[Line],
    asked: Limits,
    joints: Sequence[str],
    rest_deg: Array,
    targets_deg: Array,
    worst_n: float,
    spare: Help | None,
    remarks: Sequence[str],
) -> str:
    """The whole text; `body` is the way from the robot file to the body's."""
    rest = dict(zip(joints, rest_deg.tolist(), strict=True))
    return "\n".join(
        [
            f"# {name}: made by `myograft new` from {body}.",
            *(f"# {remark}" for remark in remarks),
            "# Masses and wires are the body file's. Limits, speeds and the task are proposals.",
            "",
            "[robot]",
            f"name = {_quoted(name)}",
            f"body = {_quoted(body)}",
            f"schema = {_quoted(name + '.safetensors')}  # myograft learn THIS_FILE",
            *_chains(chains),
            *_joints(chains, joints, rest),
            *_muscles(chains, spare),
            *_spare(chains, spare),
            *_task(targets_deg),
            "",
            "[module]",
            f"tension_limit_n = {asked.tension_limit_n:.1f}  # a module gives way above it",
            "",
            "[control]",
            f"tension_floor_n = {asked.floor_n:.1f}",
            f"# the strongest muscle has to pull {worst_n:.0f} N at least, in the worst posture",
            f"tension_ceiling_n = {asked.ceiling_n:.1f}",
            f"joint_speed_deg_s = {asked.joint_speed_deg_s:.4g}  # no wire runs too fast",
            "settle_s = 1.0",
            "",
            "[growth]",
            f"n_new = {asked.n_new}  # motions by which a new muscle is learned",
            "",
        ]
    )


def _chains(chains: Sequence[Line]) -> Iterator[str]:
    for line in chains:
        count = len(line.joints) + len(line.wires)
        yield ""
        yield f'[[chain]]  # {count} modules; a real one: link = "serial:///dev/ttyUSB0"'
        yield f"name = {_quoted(line.name)}"
        yield 'link = "sim:"'


def _joints(
    chains: Sequence[Line], joints: Sequence[str], rest_deg: dict[str, float]
) -> Iterator[str]:
    where = {
        joint: (line.name, FIRST_JOINT_ID + number)
        for line in chains
        for number, joint in enumerate(line.joints)
    }
    for joint in joints:
        chain, module = where[joint]
        yield ""
        yield "[[joint]]"
        yield f"name = {_quoted(joint)}"
        yield f"chain = {_quoted(chain)}"
        yield f"id = {module}"
        if rest_deg[joint]:
            yield f"rest_deg = {_number(rest_deg[joint])}  # where it parks"


def _muscles(chains: Sequence[Line], spare: Help | None) -> Iterator[str]:
    for line in chains:
        for number, wire in enumerate(line.wires):
            yield ""
            yield "[[muscle]]"
            yield f"name = {_quoted(wire)}"
            yield f"chain = {_quoted(line.name)}"
            yield f"id = {FIRST_MUSCLE_ID + number}"
            if spare and wire == spare.beside:
                yield f"role = {_quoted(wire)}  # it pulls hardest"


def _spare(chains: Sequence[Line], spare: Help | None) -> Iterator[str]:
    if spare is None:
        return
    path = spare.path
    yield ""
    yield "[[spare]]  # a proposal: beside the muscle that pulls hardest"
    yield f"name = {_quoted(spare.name)}"
    yield f"chain = {_quoted(next(x.name for x in chains if spare.beside in x.wires))}"
    yield f"role = {_quoted(spare.beside)}"
    yield "[spare.path]"
    yield f"attachment = {_place(path.attachment)}"
    yield f"direction = {list(path.direction)}"
    yield "relays = ["
    for place in path.relays:
        yield f"    {_place(place)},"
    yield "]"


def _task(targets_deg: Array) -> Iterator[str]:
    if not len(targets_deg):
        return
    yield ""
    yield "[[task]]"
    yield 'name = "sweep"  # through the inner of the joints\' ranges; each posture can be held'
    yield "targets_deg = ["
    for target in targets_deg.tolist():
        yield f"    [{', '.join(map(_number, target))}],"
    yield "]"


def _place(place: Place) -> str:
    if not place.wrap:
        return f"{{ link = {_quoted(place.link)}, position_m = {list(place.position_m or ())} }}"
    side = f", side = {_quoted(place.side)}" if place.side else ""
    return f"{{ wrap = {_quoted(place.wrap)}{side} }}"


def _quoted(word: str) -> str:
    """A basic string of TOML: what JSON writes is one."""
    return json.dumps(word, ensure_ascii=False)


def _number(value: float) -> str:
    return f"{value + 0.0:.6g}"
