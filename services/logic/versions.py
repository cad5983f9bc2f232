"""Every body schema that a robot ever had, by number, over a `Store`.

`v0001`, `v0002`, ... are blobs of msgpack with the schema's bytes and their checksum; `active`
names the one in use. Nothing is ever overwritten by another version or deleted, so that any
adopted one can come back.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Set

import msgspec

from runtime.logic import Store
from runtime.messages import VersionRow
from services.body_schema.schema import Schema, SchemaError

SHIPPED, CANDIDATE, ADOPTED, REFUSED = "shipped", "candidate", "adopted", "refused"
NONE = 0  # the version before the first: what the body's file draws
USABLE = (SHIPPED, ADOPTED)

_NAME = re.compile(r"v(\d{4,})")


class Version(msgspec.Struct, frozen=True, kw_only=True):
    """One stored schema and what is known of it."""

    number: int
    joints: tuple[str, ...]
    muscles: tuple[str, ...]
    method: str
    state: str  # shipped | candidate | adopted | refused
    job: str = ""
    parent: int = 0
    residual_mm: dict[str, float] = {}
    train_s: float = 0.0
    reason: str = ""  # of the verdict
    crc: int
    data: bytes


class Versions:
    """The versions of one robot.

    Attributes:
        known: number -> version, of all that can be read.
        active: the one in use, or None.
        complaints: what could not be read, in words; said once, by whoever speaks.
    """

    def __init__(self, store: Store, shipped: bytes | None) -> None:
        self.known: dict[int, Version] = {}
        self.active: Version | None = None
        self.complaints: list[str] = []
        self._store = store
        self._numbers = {
            int(match[1]) for name in store.names() if (match := _NAME.fullmatch(name))
        }
        for number in sorted(self._numbers):
            try:
                self.known[number] = _decoded(store.load(_name(number)))
            except (msgspec.MsgspecError, SchemaError) as error:
                self.complaints.append(f"stored schema version {number} cannot be read: {error}")
        self._choose()
        if self.active is None and shipped is not None:
            self._take_shipped(shipped)

    def schema(self, number: int) -> Schema:
        """The schema of a version.

        Raises:
            SchemaError: there is no such version, or it cannot be read.
        """
        if number in self.known:
            return Schema.from_bytes(self.known[number].data)
        why = "cannot be read" if number in self._numbers else "is not stored"
        raise SchemaError(f"schema version {number} {why}")

    def rows(self) -> list[VersionRow]:
        """All that can be read, as they are listed."""
        return [
            VersionRow(
                version=version.number,
                state=version.state,
                active=version is self.active,
                method=version.method,
                muscles=version.muscles,
                parent=version.parent,
                residual_mm=version.residual_mm,
                train_s=version.train_s,
                reason=version.reason,
            )
            for version in self.known.values()
        ]

    def of_job(self, job: str) -> Version | None:
        """The newest version that a training job made."""
        made = [version for version in self.known.values() if job and version.job == job]
        return made[-1] if made else None

    def last_with(self, muscles: Set[str]) -> Version | None:
        """The newest version in use once that has exactly these muscles."""
        fit = [v for v in self.known.values() if set(v.muscles) == muscles and v.state in USABLE]
        return fit[-1] if fit else None

    def add(
        self, schema: Schema, method: str, state: str, job: str, parent: int, train_s: float
    ) -> Version:
        """Keep a schema under the next number."""
        data = schema.to_bytes()
        version = Version(
            number=max(self._numbers, default=0) + 1,
            joints=schema.joints,
            muscles=schema.muscles,
            method=method,
            state=state,
            job=job,
            parent=parent,
            residual_mm=schema.residual_mm,
            train_s=train_s,
            crc=zlib.crc32(data),
            data=data,
        )
        self._keep(version)
        return version

    def activate(self, version: Version) -> None:
        """Take a version into use. `active` is written first: a crash in between is mended."""
        self._store.save("active", str(version.number).encode())
        if version.state not in USABLE:
            version = msgspec.structs.replace(version, state=ADOPTED)
        self._keep(version)
        self.active = version

    def refuse(self, version: Version, reason: str) -> None:
        """Remember that a candidate did not pass."""
        self._keep(msgspec.structs.replace(version, state=REFUSED, reason=reason))

    def _keep(self, version: Version) -> None:
        self._store.save(_name(version.number), msgspec.msgpack.encode(version))
        self._numbers.add(version.number)
        self.known[version.number] = version

    def _choose(self) -> None:
        """The version that `active` names; if it is lost, the last usable one before it."""
        word = self._store.load("active") or b""
        wanted = int(word) if word.isdigit() else max(self._numbers, default=0)
        if word.isdigit() and wanted in self.known:
            self.activate(self.known[wanted])
            return
        usable = [number for number, v in self.known.items() if v.state in USABLE]
        before = [number for number in usable if number <= wanted] or usable
        if before:
            self.active = self.known[max(before)]
            self.complaints.append(f"schema version {max(before)} is used instead of {wanted}")

    def _take_shipped(self, data: bytes) -> None:
        try:
            schema = Schema.from_bytes(data)
        except SchemaError as error:
            self.complaints.append(f"the schema that ships with the robot cannot be read: {error}")
        else:
            self.activate(self.add(schema, SHIPPED, SHIPPED, job="", parent=0, train_s=0.0))


def _name(number: int) -> str:
    return f"v{number:04d}"


def _decoded(blob: bytes | None) -> Version:
    version = msgspec.msgpack.decode(blob or b"", type=Version)
    if zlib.crc32(version.data) != version.crc:
        raise SchemaError("its checksum does not fit")
    Schema.from_bytes(version.data)
    return version
