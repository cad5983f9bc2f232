"""The file in which a sweep keeps what is done: readable after any crash, written by one sweep.

`units.jsonl`: the first line holds the fingerprint, the settings that define the experiment; each
further line is one unit, `{"key", "unit", "wall_s", "runs"}` or `{"key", "unit", "error"}`.
The last word on a unit counts.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self

from experiments.statistics import Run

_SHOWN = 3  # differences that are spelt out


class SweepError(RuntimeError):
    """A sweep cannot go on; says why and what to do."""


class Store:
    """What is kept of one experiment's units, to be used in a `with`.

    Args:
        folder: where `units.jsonl` lies, or will; made if it is not there.
        fingerprint: everything that decides about the results, but for what a unit says itself.
            Anything that JSON can hold.
        fresh: begin anew; what was kept stays beside, as `units-1.jsonl`, `units-2.jsonl`, ...

    Raises:
        SweepError: another sweep writes there, the results there are of other settings, or the
            file is damaged elsewhere than at its end.
    """

    def __init__(
        self, folder: Path, fingerprint: Mapping[str, Any], *, fresh: bool = False
    ) -> None:
        self.path = folder / "units.jsonl"
        self.fingerprint: dict[str, Any] = json.loads(json.dumps(fingerprint))
        self._units: dict[str, dict[str, Any]] = {}
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = (folder / ".lock").open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise SweepError(f"another sweep writes to {folder}: wait for it, or --out") from None
        try:
            if fresh:
                self._set_aside()
            length = self._read()
        except SweepError:
            self._lock.close()
            raise
        self._file = self.path.open("ab")
        self._file.truncate(length)  # a torn last line goes
        if length == 0:
            self._write(json.dumps({"fingerprint": self.fingerprint}))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._lock.close()

    def is_done(self, key: str) -> bool:
        """Whether that unit was run and did not fail."""
        return "runs" in self._units.get(key, {})

    def append(self, line: str) -> None:
        """Keep one unit; when this returns it is on disk."""
        self._write(line)
        self._take(json.loads(line))

    def runs(self, keys: Iterable[str]) -> list[Run]:
        """All rows of those units."""
        return [run for key in keys for run in self._units.get(key, {}).get("runs", [])]

    def worked_s(self, keys: Iterable[str]) -> float:
        """Wall time that those units took, one after another."""
        return float(sum(self._units.get(key, {}).get("wall_s", 0.0) for key in keys))

    def failed(self, keys: Iterable[str]) -> dict[str, str]:
        """Those among the units that failed when last tried, with their error."""
        found = {key: self._units.get(key, {}).get("error", "") for key in keys}
        return {key: error for key, error in found.items() if error}

    def _read(self) -> int:
        """Take in what is there; how many bytes of it are whole lines."""
        if not self.path.exists():
            return 0
        length = 0
        for number, line in enumerate(self.path.read_bytes().splitlines(keepends=True), 1):
            if not line.endswith(b"\n"):
                break
            try:
                row = json.loads(line)
                if number == 1:
                    self._compare(row["fingerprint"])
                else:
                    self._take(row)
            except (ValueError, KeyError, TypeError) as error:
                raise SweepError(
                    f"{self.path}:{number} is damaged: remove that line, or --fresh"
                ) from error
            length += len(line)
        return length

    def _take(self, row: dict[str, Any]) -> None:
        self._units[row["key"]] = row

    def _write(self, line: str) -> None:
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _compare(self, kept: dict[str, Any]) -> None:
        old, new = _flat(kept), _flat(self.fingerprint)
        differ = [
            f"{name} {_told(old, name)}, now {_told(new, name)}"
            for name in sorted(old.keys() | new.keys())
            if _told(old, name) != _told(new, name)
        ]
        if differ:
            more = f" and {len(differ) - _SHOWN} more" if len(differ) > _SHOWN else ""
            raise SweepError(
                f"{self.path.parent} holds results of other settings "
                f"(was: {'; was: '.join(differ[:_SHOWN])}{more}): "
                f"--out another folder, or --fresh to begin anew"
            )

    def _set_aside(self) -> None:
        if self.path.exists():
            number = 1
            while (aside := self.path.with_name(f"units-{number}.jsonl")).exists():
                number += 1
            self.path.rename(aside)


def _flat(settings: Any, name: str = "") -> dict[str, Any]:
    """Nested settings by dotted names."""
    if not isinstance(settings, dict) or not settings:
        return {name: settings}
    return {
        path: value
        for key, inner in settings.items()
        for path, value in _flat(inner, f"{name}.{key}" if name else key).items()
    }


def _told(settings: dict[str, Any], name: str) -> str:
    return json.dumps(settings[name]) if name in settings else "(not there)"
