"""What a robot file says of its body: muscles are tendons, joints exist, paths use real places.

The body is read as XML only, see `body_names.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from runtime.body_names import BodyError, BodyNames, read_body
from runtime.coordinates import AXES, parts
from runtime.messages import MusclePath, Place
from runtime.settings import RobotSettings
from runtime.settings_file import Mistake, close_file, shown
from runtime.suggestion import suggestion
from runtime.toml_lines import KeyPath


def body_mistakes(settings: RobotSettings) -> Iterator[Mistake]:
    """What the robot file and its body do not agree on."""
    key = ("robot", "body")
    file = settings.body_file
    if not file.is_file():
        hint = close_file(file, file.parent.glob("*.xml"))
        yield Mistake(key, f"body file {shown(file)} does not exist{hint}")
        return
    try:
        body = read_body(file)
    except BodyError as error:
        yield Mistake(key, f"body file {shown(file)} {error}")
        return
    if not body.tendons:
        yield Mistake(key, f"{body.file} has no spatial tendon, so there is nothing to pull with")
        return
    for index, joint in enumerate(settings.joint):
        if joint.name not in body.joints:
            hint = suggestion(joint.name, body.joints)
            yield Mistake(("joint", index, "name"), f"no joint '{joint.name}' in {body.file}{hint}")
        elif joint.name in body.tied:
            leader = body.tied[joint.name]
            how = f"follows '{leader}'" if leader else "is held still"
            yield Mistake(
                ("joint", index, "name"),
                f"joint '{joint.name}' {how} by an equality in {body.file}: nobody commands it;"
                " remove this [[joint]]",
            )
        elif missing := _missing_parts(joint.name, settings, body):
            yield Mistake(
                ("joint", index, "name"),
                f"'{joint.name}' is a part of a ball joint and goes with all three; add a [[joint]]"
                f" '{missing[0]}'",
            )
    for index, muscle in enumerate(settings.muscle):
        if muscle.name not in body.tendons:
            hint = suggestion(muscle.name, body.tendons)
            yield Mistake(
                ("muscle", index, "name"),
                f"muscle '{muscle.name}' has no tendon in {body.file}{hint}",
            )
    for index, spare in enumerate(settings.spare):
        where = ("spare", index, "path")
        yield from path_mistakes(spare.path, where, f"spare '{spare.name}': ", body)
    for index, payload in enumerate(settings.payload):
        for field, name in (("link", payload.link), ("name", payload.name)):
            if name not in body.links:
                hint = suggestion(name, body.links - {"", "world"})
                yield Mistake(
                    ("payload", index, field),
                    f"payload '{payload.name}': no body '{name}' in {body.file}{hint}",
                )
    yield from _angles(settings, body)


def _missing_parts(name: str, settings: RobotSettings, body: BodyNames) -> list[str]:
    base, _, axis = name.rpartition("/")
    if axis not in AXES or not set(parts(base)) <= body.joints.keys():
        return []
    return [part for part in parts(base) if part not in settings.joints]


def _angles(settings: RobotSettings, body: BodyNames) -> Iterator[Mistake]:
    """Angles that the body's joints cannot take."""
    for number, joint in enumerate(settings.joint):
        low, high = body.joints.get(joint.name) or (-math.inf, math.inf)
        wanted: list[tuple[KeyPath, str, float]] = [
            (("joint", number, "rest_deg"), f"joint '{joint.name}': rest_deg", joint.rest_deg)
        ]
        wanted += [
            (
                ("task", index, "targets_deg", step, number),
                f"task '{task.name}', target {step + 1}: joint '{joint.name}' at",
                target[number],
            )
            for index, task in enumerate(settings.task)
            for step, target in enumerate(task.targets_deg)
        ]
        for key, what, angle in wanted:
            if not low - 1e-6 <= angle <= high + 1e-6 or not math.isfinite(angle):
                yield Mistake(
                    key,
                    f"{what} {angle:g} deg is outside its range in {body.file},"
                    f" {low:g} to {high:g} deg",
                )


def path_mistakes(
    path: MusclePath, where: KeyPath = (), owner: str = "", body: BodyNames | None = None
) -> Iterator[Mistake]:
    """What is wrong with a muscle's path; with a body, also names that it does not know."""
    places = [((*where, "attachment"), "attachment", path.attachment)]
    places += [
        ((*where, "relays", index), f"relay {index + 1}", relay)
        for index, relay in enumerate(path.relays)
    ]
    for key, name, place in places:
        yield from _place(place, key, f"{owner}{name}", body)
    if path.attachment.wrap:
        yield Mistake(
            (*where, "attachment"), f"{owner}attachment has to be fixed: give link and position_m"
        )
    if not path.relays or path.relays[-1].wrap:
        yield Mistake(
            (*where, "relays"),
            f"{owner}the last of the relays is where the wire ends: give its link and position_m",
        )
    if not any(path.direction) or not all(map(math.isfinite, path.direction)):
        yield Mistake(
            (*where, "direction"),
            f"{owner}direction has no direction; give a vector like [0, 0, -1]",
        )


def _place(place: Place, key: KeyPath, name: str, body: BodyNames | None) -> Iterator[Mistake]:
    fixed = bool(place.link) and place.position_m is not None
    if fixed == bool(place.wrap) or (place.wrap and (place.link or place.position_m)):
        yield Mistake(key, f"{name} needs either link and position_m, or wrap (and side)")
    elif place.side and not place.wrap:
        yield Mistake((*key, "side"), f"{name}: side goes with wrap only; remove it")
    elif place.position_m and not all(abs(value) < 10.0 for value in place.position_m):
        yield Mistake((*key, "position_m"), f"{name}: position_m is in metres of the link's frame")
    if body is None:
        return
    for field, kind, word, known in (
        ("link", "body", place.link, body.links),
        ("wrap", "geom", place.wrap, body.wraps),
        ("side", "site", place.side, body.sites),
    ):
        if word and word not in known:
            hint = suggestion(word, known - {"", "world"})
            yield Mistake((*key, field), f"{name}: no {kind} '{word}' in {body.file}{hint}")
