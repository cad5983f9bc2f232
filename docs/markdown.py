"""Pages of Markdown that are made from the code."""

from __future__ import annotations

import re
from collections.abc import Iterable

MADE = "<!-- Made from the code by `python -m docs.reference`: change the code, not this page. -->"


def page(parts: Iterable[str]) -> str:
    """A page of its title and its paragraphs."""
    title, *rest = parts
    return "\n\n".join([f"# {title}", MADE, *rest]) + "\n"


def table(head: str, rows: Iterable[Iterable[str]]) -> str:
    """A table; `head` is its titles with `|` between them."""
    titles = head.split("|")
    cells = [titles, *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    first, *lines = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([first, "|---" * len(titles) + "|", *lines])


def code(text: str) -> str:
    """The text as code; nothing stays nothing."""
    return f"`{text}`" if text else ""


def toml(default: str) -> str:
    """A default of a Python field as TOML writes it; without one the key is needed."""
    if default in ("", "None", "()"):
        return "" if default else "needed"
    text = default.translate(str.maketrans("'()", '"[]'))
    return code(re.sub(r"\bTrue\b|\bFalse\b", lambda word: word[0].lower(), text))
