"""Blobs in a folder, each whole or not there at all, whatever the power does."""

from __future__ import annotations

import os
import re
from pathlib import Path

_SAFE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


class FileStore:
    """A `Store` (see logic.py): a blob is a file, replaced by rename after fsync."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def load(self, name: str) -> bytes | None:
        """The blob of that name, or None."""
        try:
            return self._path(name).read_bytes()
        except FileNotFoundError:
            return None

    def save(self, name: str, data: bytes) -> None:
        """Keep a blob: when this returns, it survives a power cut."""
        path = self._path(name)
        self.folder.mkdir(parents=True, exist_ok=True)
        fresh = self.folder / f".{name}.fresh"
        with fresh.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            os.fsync(folder)  # else the rename itself may be lost
        finally:
            os.close(folder)

    def names(self) -> list[str]:
        """All names, sorted."""
        if not self.folder.is_dir():
            return []
        return sorted(
            path.name
            for path in self.folder.iterdir()
            if path.is_file() and not path.name.startswith(".")
        )

    def _path(self, name: str) -> Path:
        if not _SAFE.fullmatch(name):
            raise ValueError(f"{name!r} is no name for a blob: letters, digits, . _ - only")
        return self.folder / name
