"""Which names does a body (MJCF) know? Read as plain XML, so that nobody needs MuJoCo for it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from runtime.coordinates import part_limit, parts


class BodyError(ValueError):
    """A body file that is missing or not MJCF, said in words."""


@dataclass
class BodyNames:
    """Names that a robot file may refer to, and how far the joints go."""

    file: str
    # coordinates -> range in deg; of a slide, 1 m counts as 1 rad
    joints: dict[str, tuple[float, float] | None] = field(default_factory=dict)
    tied: dict[str, str] = field(default_factory=dict)  # joint -> the one it follows, or ""
    tendons: set[str] = field(default_factory=set)  # spatial ones: each is a wire
    links: set[str] = field(default_factory=set)
    wraps: set[str] = field(default_factory=set)  # geoms
    sites: set[str] = field(default_factory=set)


def read_body(path: Path) -> BodyNames:
    """Collect the names of an MJCF file and of what it includes.

    Raises:
        BodyError: the file is missing, is no XML or no MJCF.
    """
    root = _parse(path, ())
    if root.tag != "mujoco":
        raise BodyError(f"is not a MuJoCo body: its outermost element is <{root.tag}>")
    names = BodyNames(path.name)
    compiler = root.find("compiler")
    in_radian = compiler is not None and compiler.get("angle") == "radian"
    to_deg = 180.0 / math.pi if in_radian else 1.0
    defaults = dict(_joint_styles(root))
    for world in root.iter("worldbody"):
        names.links.add("world")
        for element, style in _within(world, "main"):
            name = element.get("name", "")
            if element.tag == "body":
                names.links.add(name)
            elif element.tag == "geom":
                names.wraps.add(name)
            elif element.tag == "site":
                names.sites.add(name)
            elif element.tag == "joint":
                like = {**defaults.get(element.get("class", style), {}), **element.attrib}
                names.joints.update(_coordinates(name, like, to_deg))
    for tie in root.iterfind("equality/joint"):
        if tie.get("active", "true") == "true":
            names.tied[tie.get("joint1", "")] = tie.get("joint2", "")
    names.tendons.update(wire.get("name", "") for wire in root.iterfind("tendon/spatial"))
    return names


def _coordinates(
    name: str, like: Mapping[str, str], to_deg: float
) -> Iterator[tuple[str, tuple[float, float] | None]]:
    """What a robot file may call a joint's angles, and how far they go; see `coordinates.py`."""
    kind = like.get("type", "hinge")
    if kind == "free":
        return
    limits = _range_deg(like.get("range", ""), math.degrees(1.0) if kind == "slide" else to_deg)
    if kind != "ball":
        yield name, limits
        return
    most = part_limit(limits[1]) if limits else 0.0
    for part in parts(name):
        yield part, (-most, most) if limits else None


def _range_deg(text: str, to_deg: float) -> tuple[float, float] | None:
    """Two numbers, or None for a joint that goes as far as it likes."""
    try:
        low, high = (float(word) * to_deg for word in text.split())
    except ValueError:
        return None  # no range, or one that MuJoCo will have its own word on
    return low, high


def _parse(path: Path, within: tuple[Path, ...]) -> ET.Element:
    """The file's element tree with every `<include>` put in its place.

    As in MuJoCo, included files lie beside the outermost one (`within[0]`).
    """
    if path in within:
        raise BodyError("includes itself")
    within = (*within, path)
    try:
        root = ET.fromstring(path.read_bytes())
    except ET.ParseError as error:
        raise BodyError(f"is not XML: {error}") from None
    except OSError as error:
        raise BodyError(f"cannot be read: {error.strerror}") from None
    for parent in list(root.iter()):
        for index, child in reversed(list(enumerate(parent))):
            if child.tag == "include":
                try:
                    file = within[0].parent / child.get("file", "")
                    parent[index : index + 1] = list(_parse(file, within))
                except BodyError as error:
                    raise BodyError(f"includes {child.get('file')}, which {error}") from None
    return root


def _joint_styles(root: ET.Element) -> Iterator[tuple[str, dict[str, str]]]:
    """Default class -> its joints' attributes, inherited from the classes around it."""

    def walk(
        style: ET.Element, name: str, inherited: dict[str, str]
    ) -> Iterator[tuple[str, dict[str, str]]]:
        joint = style.find("joint")
        own = {**inherited, **({} if joint is None else joint.attrib)}
        yield name, own
        for child in style.iterfind("default"):
            yield from walk(child, child.get("class", ""), own)

    for top in root.iterfind("default"):
        yield from walk(top, top.get("class", "main"), {})


def _within(parent: ET.Element, style: str) -> Iterator[tuple[ET.Element, str]]:
    """Everything below `parent` with the default class that holds there."""
    for child in parent:
        yield child, style
        yield from _within(child, child.get("childclass", style))
