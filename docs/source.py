"""What the source text of a module says of its classes: fields, types, and trailing comments.

A field's meaning is the comment behind it, where a programmer reads it, too.
"""

from __future__ import annotations

import ast
import inspect
import io
import re
import tokenize
from dataclasses import dataclass
from functools import cache
from types import ModuleType

UNITS = {  # endings of names, the longer ones first
    "_degc_n2": "degC/N²",
    "_deg_s": "deg/s",
    "_n_m": "N/m",
    "_m_s": "m/s",
    "_degc": "degC",
    "_percent": "%",
    "_deg": "deg",
    "_rad": "rad",
    "_hz": "Hz",
    "_kg": "kg",
    "_mb": "MB",
    "_mm": "mm",
    "_ms": "ms",
    "_ns": "ns",
    "_m": "m",
    "_n": "N",
    "_s": "s",
}
_WORDS = {"str": "text", "int": "integer", "float": "number", "bool": "true or false"}


@dataclass(frozen=True)
class Field:
    """One field of a struct, or one member of an enumeration."""

    name: str
    type: str
    default: str  # as it is written; "" when there is none
    meaning: str

    @property
    def unit(self) -> str:
        """By the ending of its name; "" when that tells none."""
        return next((unit for ending, unit in UNITS.items() if self.name.endswith(ending)), "")


@dataclass(frozen=True)
class Class:
    """One class, with its own fields only."""

    name: str
    section: str  # the heading above it: `# ── the daisy chains ──`
    fields: tuple[Field, ...]


@cache
def classes(module: ModuleType) -> dict[str, Class]:
    """Every class of a module, in the order of the text."""
    text = inspect.getsource(module)
    comments, headings = _comments(text)
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef):
            above = [words for line, words in headings.items() if line < node.lineno]
            fields = tuple(filter(None, (_field(row, comments) for row in node.body)))
            found[node.name] = Class(node.name, above[-1] if above else "", fields)
    return found


def _comments(text: str) -> tuple[dict[int, str], dict[int, str]]:
    """Line -> comment behind code, and line -> heading."""
    comments, headings = {}, {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT:
            continue
        line, column = token.start
        words = token.string.lstrip("# ")
        if token.line[:column].strip():
            comments[line] = words
        elif rule := re.fullmatch(r"── (.*?) ─+", words):
            headings[line] = rule[1]
    return comments, headings


def _field(node: ast.stmt, comments: dict[int, str]) -> Field | None:
    lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
    meaning = " ".join(comments[line] for line in lines if line in comments)
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        default = ast.unparse(node.value) if node.value else ""
        return Field(node.target.id, _type(node.annotation), default, meaning)
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):  # of an Enum
        return Field(node.targets[0].id, "", ast.unparse(node.value), meaning)
    return None


def _type(node: ast.expr) -> str:
    """`tuple[float, ...]` -> `[number, ...]`, as the data look in MessagePack or TOML."""
    match node:
        case ast.Name(id=name):
            return _WORDS.get(name, name)
        case ast.Constant(value=None):
            return "nothing"
        case ast.BinOp(left=left, right=right):
            return f"{_type(left)} or {_type(right)}"
        case ast.Subscript(value=ast.Name(id="tuple"), slice=ast.Tuple(elts=parts)):
            return "[" + ", ".join("..." if _is_dots(x) else _type(x) for x in parts) + "]"
        case ast.Subscript(value=ast.Name(id="dict"), slice=ast.Tuple(elts=[key, value])):
            return f"{{{_type(key)}: {_type(value)}}}"
        case ast.Subscript(value=ast.Name(id="Literal"), slice=ast.Tuple(elts=parts)):
            return " or ".join(ast.unparse(part).replace("'", '"') for part in parts)
    return ast.unparse(node)


def _is_dots(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is Ellipsis
