"""On which line of a TOML file does a key stand? `tomllib` reads values and forgets that.

`locate` walks text that `tomllib` has already accepted, so it only has to find its way, not to
judge: `locate(text)["muscle", 2, "id"]` is the line of `id` in the third `[[muscle]]`.
"""

from __future__ import annotations

import re
import tomllib

KeyPath = tuple[str | int, ...]

_SPACE = re.compile(r"(?:\s|#[^\n]*)*")
_STRING = re.compile(
    r'"""(?:\\.|[^\\])*?"""(?:"{0,2})' r"|'''.*?'''(?:'{0,2})" r'|"(?:\\.|[^"\\])*"' r"|'[^']*'",
    re.DOTALL,
)
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(r"[^,\]}#\n]+")  # numbers, booleans, dates (which may hold a blank)


def locate(text: str) -> dict[KeyPath, int]:
    """The line, counted from 1, of every table, key and array element of valid TOML."""
    return _Walk(text).lines


def line_of(lines: dict[KeyPath, int], path: KeyPath) -> int:
    """The line of `path`, or of the nearest table around it that is written down."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


class _Walk:
    """One pass over the text; `at` is where it stands."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[KeyPath, int] = {}
        self._tables: dict[KeyPath, int] = {}  # array of tables -> how many so far
        table: KeyPath = ()
        while self._next():
            table = self._header() if self._next() == "[" else self._pair(table)

    def _next(self) -> str:
        """Skip blanks and comments; the character there, or "" at the end."""
        space = _SPACE.match(self.text, self.at)
        assert space is not None  # the pattern matches nothing, too
        self.at = space.end()
        return self.text[self.at : self.at + 1]

    def _mark(self, path: KeyPath) -> None:
        """Every part of a dotted key stands where it was first written."""
        line = self.text.count("\n", 0, self.at) + 1
        for end in range(1, len(path) + 1):
            self.lines.setdefault(path[:end], line)

    def _header(self) -> KeyPath:
        several = self.text.startswith("[[", self.at)
        self.at += 2 if several else 1
        self._next()
        start = self.at
        parts = self._key()
        path: KeyPath = ()
        for part in parts[:-1]:
            path = self._newest((*path, part))
        path = (*path, parts[-1])
        if several:
            self._tables[path] = self._tables.get(path, 0) + 1
            path = self._newest(path)
        end, self.at = self.at, start
        self._mark(path)
        self._next()
        self.at = self.text.index("]", end) + (2 if several else 1)
        return path

    def _newest(self, path: KeyPath) -> KeyPath:
        """`muscle` means the last `[[muscle]]`."""
        return (*path, self._tables[path] - 1) if path in self._tables else path

    def _pair(self, table: KeyPath) -> KeyPath:
        start = self.at
        path = (*table, *self._key())
        end, self.at = self.at, start
        self._mark(path)
        self.at = self.text.index("=", end) + 1
        self._value(path)
        return table

    def _key(self) -> tuple[str, ...]:
        parts = []
        while True:
            quoted = self._next() in ('"', "'")
            found = (_STRING if quoted else _BARE_KEY).match(self.text, self.at)
            assert found is not None  # tomllib has accepted this key
            word = found.group()
            parts.append(tomllib.loads(f"k = {word}")["k"] if quoted else word)
            self.at = found.end()
            if self._next() != ".":
                return tuple(parts)
            self.at += 1

    def _value(self, path: KeyPath) -> None:
        first = self._next()
        if first == "[":
            self._items(path, "]")
        elif first == "{":
            self._items(path, "}")
        else:
            pattern = _STRING if first in ('"', "'") else _SCALAR
            found = pattern.match(self.text, self.at)
            assert found is not None  # tomllib has accepted this value
            self.at = found.end()

    def _items(self, path: KeyPath, close: str) -> None:
        """The elements of an array, or the pairs of an inline table."""
        self.at += 1
        index = 0
        while self._next() != close:
            if close == "}":
                self._pair(path)
            else:
                self._mark((*path, index))
                self._value((*path, index))
                index += 1
            if self._next() == ",":
                self.at += 1
        self.at += 1
