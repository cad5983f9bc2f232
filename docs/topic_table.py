"""Write ARCHITECTURE.md's topic table from `runtime/topics.py`: `python -m docs.topic_table`."""

from __future__ import annotations

from pathlib import Path

from runtime.messages import Message
from runtime.topics import REQUESTS, TOPICS, Topic

PAGE = Path(__file__).parent.parent / "ARCHITECTURE.md"
BEGIN, END = "<!-- topics -->", "<!-- /topics -->"


def render() -> str:
    """Both tables, as Markdown."""
    lines = ["| key | message | rate | keep | says |", "|---|---|---|---|---|"]
    lines += [
        f"| `{{robot}}/{row.key}` | `{row.message.__name__}` | {_rate(row)} | {row.keep.value} |"
        f" {_says(row.message)} |"
        for row in TOPICS
    ]
    lines += ["", "| request | message | answered within | asks to |", "|---|---|---|---|"]
    lines += [
        f"| `{{robot}}/{row.key}` | `{row.message.__name__}` | {row.timeout_s:g} s |"
        f" {_says(row.message)} |"
        for row in REQUESTS
    ]
    return "\n".join(lines)


def with_table(page: str) -> str:
    """The page with the present table between its markers."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{render()}\n{END}{after}"


def _rate(row: Topic) -> str:
    return f"{row.rate_hz:g} Hz" if row.rate_hz else "when it happens"


def _says(message: type[Message]) -> str:
    return (message.__doc__ or "").strip().splitlines()[0]


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
