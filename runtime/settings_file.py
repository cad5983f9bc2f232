"""A TOML file read as one of our types, or one `SettingsError` naming file, line and remedy."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args

import msgspec

from runtime.suggestion import suggestion
from runtime.toml_lines import KeyPath, line_of, locate

T = TypeVar("T", bound=msgspec.Struct)


class SettingsError(ValueError):
    """A mistake in a robot file, in one line that a person can act on."""


class Mistake(NamedTuple):
    """What is wrong with the value at one key path."""

    path: KeyPath
    text: str


def read_toml(path: Path, kind: type[T], others: Iterable[Path] = ()) -> T:
    """The file as `kind`. `others` are files that may be meant when this one is missing.

    Raises:
        SettingsError: it cannot be read, is not TOML, or a key is missing, unknown or mistyped.
    """
    tables = _parse(path, others)
    try:
        return msgspec.convert(tables, kind)
    except msgspec.ValidationError as error:
        raise located(path, _explain(str(error), tables, kind)) from None


def located(path: Path, mistake: Mistake) -> SettingsError:
    """The error for a mistake in a file that is valid TOML."""
    line = line_of(locate(path.read_text(encoding="utf-8")), mistake.path)
    text = mistake.text.replace("\n", "\\n")  # of a name that has one
    return SettingsError(f"{shown(path)}:{line}: {text}")


def shown(path: Path) -> str:
    """The path as a person would type it here."""
    path, here = path.resolve(), Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def close_file(path: Path, others: Iterable[Path]) -> str:
    """`; did you mean deploy/robots/elbow.toml?`, by the files' names, or all there are."""
    near = {file.stem: shown(file) for file in others}
    close = difflib.get_close_matches(path.stem, near, n=1) or sorted(near)
    return f"; did you mean {' or '.join(near[stem] for stem in close)}?" if close else ""


def called(tables: Any, path: KeyPath) -> str:
    """What a person calls the table at `path`: `muscle 'biceps_1'`, `[robot]`, `the file`."""
    if not path:
        return "the file"
    words: list[str] = []
    for depth, part in enumerate(path):
        tables = tables[part] if _holds(tables, part) else None
        following = path[depth + 1] if depth + 1 < len(path) else None
        if isinstance(part, int):
            name = tables.get("name") if isinstance(tables, dict) else None
            words[-1] += f" '{name}'" if isinstance(name, str) else f" number {part + 1}"
        else:
            words.append(str(part) if isinstance(following, int) or depth else f"[{part}]")
    return ", ".join(words)


def _holds(tables: Any, part: str | int) -> bool:
    if isinstance(part, int):
        return isinstance(tables, list) and part < len(tables)
    return isinstance(tables, dict) and part in tables


def _parse(path: Path, others: Iterable[Path]) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text)
    except FileNotFoundError:
        hint = close_file(path, (*path.parent.glob("*.toml"), *others))
        raise SettingsError(f"{shown(path)}: no such file{hint}") from None
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        line = found.group(1) if found else str(text.count("\n") + 1)
        what = re.sub(r" \(at .*\)$", "", str(error))
        column = f" at column {found.group(2)}" if found else " at the end of the file"
        raise SettingsError(f"{shown(path)}:{line}: not valid TOML: {what}{column}") from None
    except UnicodeDecodeError as error:
        line = str(path.read_bytes()[: error.start].count(b"\n") + 1)
        raise SettingsError(f"{shown(path)}:{line}: not UTF-8 text; save it as UTF-8") from None
    except OSError as error:
        raise SettingsError(f"{shown(path)}: cannot be read: {error.strerror}") from None


# ── what msgspec says, in a person's words ────────────────────────────────────────────────────

_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "a string in quotes",
    "bool": "true or false",
    "array": "an array",
    "object": "a table",
    "null": "nothing",
}


def _explain(text: str, tables: dict[str, Any], kind: type[msgspec.Struct]) -> Mistake:
    """Turn `Expected `int`, got `str` - at `$.muscle[0].id`` into a mistake."""
    what, _, where = text.partition(" - at `$")
    path = tuple(
        int(index) if index else name for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", where)
    )
    quoted = re.findall(r"`([^`]*)`", what)
    table = called(tables, path)
    if "unknown field" in what:
        known = {field.name for field in msgspec.structs.fields(_kind_at(kind, path))}
        known -= {"file"}  # filled in after reading
        hint = suggestion(quoted[0], known)
        return Mistake((*path, quoted[0]), f"{table} has no key '{quoted[0]}'{hint}")
    if "missing required field" in what:
        several = not path and str(_kind_at(kind, (quoted[0],))).startswith("tuple")
        name = f"[[{quoted[0]}]]" if several else f"[{quoted[0]}]" if not path else quoted[0]
        return Mistake(path, f"{table} lacks {name}")
    key, owner = str(path[-1]), called(tables, path[:-1])
    if isinstance(path[-1], int):
        key, owner = f"element {path[-1] + 1}", called(tables, path[:-1])
    if len(path) == 1 and {quoted[0], quoted[1]} == {"array", "object"}:
        brackets = f"[[{key}]]" if quoted[0] == "array" else f"[{key}]"
        return Mistake(path, f"'{key}' has to be {_WORDS[quoted[0]]}; write {brackets}")
    wanted = _WORDS.get(quoted[0], quoted[0])
    length = re.search(r"of length (\d+), got (\d+)", what)
    if length:
        wanted, found = f"{length.group(1)} numbers", f"{length.group(2)} of them"
    else:
        found = f"{_value_at(tables, path)!r}, {_WORDS.get(quoted[1], 'a ' + quoted[1])}"
    return Mistake(path, f"{owner}: {key} has to be {wanted}, found {found}")


def _kind_at(kind: Any, path: KeyPath) -> Any:
    """The struct type that the table at `path` is read as."""
    for part in path:
        if isinstance(part, int):
            kind = get_args(kind)[0]
        else:
            kind = next(f.type for f in msgspec.structs.fields(kind) if f.name == part)
    return kind


def _value_at(tables: Any, path: KeyPath) -> Any:
    for part in path:
        tables = tables[part]
    return tables
