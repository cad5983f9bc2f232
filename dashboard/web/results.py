"""What an experiment found, as tables and pictures for the page of results.

A folder is what `python -m experiments` writes (`tables.md` and pictures), or one of documents that
it wrote by `--json`, with pictures of the same name beside them or in the folder `pictures` next to
it. Experiments' own folders and the repository's documents are found by themselves, others are
named in `[web] results`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from runtime.hubs import state_home
from runtime.settings import RobotSettings

PICTURES = (".png", ".svg")
LONGEST = 64 * 1024 * 1024  # bytes of a document

_DOCUMENTS = Path(__file__).parents[2] / "docs" / "results"
_UNITS = {"_rad": "rad", "_n": "N", "_mm": "mm", "_m": "m", "_percent": "%", "_s": "s"}

Table = dict[str, Any]  # title, head, rows


@dataclass(frozen=True, slots=True)
class Findings:
    """One experiment's results."""

    name: str
    title: str
    tables: Path  # tables.md, or a document
    pictures: dict[str, Path] = field(default_factory=dict)  # by file name


def folders_of(*robots: RobotSettings) -> tuple[Path, ...]:
    """Where to look: in what robot files name, experiments' own folder, the documents."""
    named = (settings.beside(folder) for settings in robots for folder in settings.web.results)
    return (*named, state_home() / "experiments", _DOCUMENTS)


def missing_folders(settings: RobotSettings) -> list[Path]:
    """Those that the robot file names and that are not there."""
    named = (settings.beside(folder) for folder in settings.web.results)
    return [folder for folder in named if not folder.is_dir()]


def find(folders: tuple[Path, ...]) -> dict[str, Findings]:
    """All results by name, those with pictures first; of two of one name the first counts."""
    found: dict[str, Findings] = {}
    for folder in folders:
        for one in _in_folder(folder):
            found.setdefault(one.name, one)
    return dict(sorted(found.items(), key=lambda item: not item[1].pictures))


def read(one: Findings) -> dict[str, Any]:
    """Tables and names of pictures; a file that cannot be read is a sentence in `problem`."""
    told: dict[str, Any] = {"name": one.name, "title": one.title, "pictures": list(one.pictures)}
    try:
        if one.tables.stat().st_size > LONGEST:
            raise ValueError(f"it is longer than {LONGEST // 2**20} MB")
        text = one.tables.read_text(encoding="utf-8")
        is_document = one.tables.suffix == ".json"
        tables = _document(json.loads(text)) if is_document else _markdown(text)
        return {**told, "tables": list(tables)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return {**told, "tables": [], "problem": f"{one.tables.name} cannot be read: {error}"}


def _in_folder(folder: Path) -> Iterator[Findings]:
    if not folder.is_dir():
        return
    for inner in (folder, *sorted(path for path in folder.iterdir() if path.is_dir())):
        tables = inner / "tables.md"
        if tables.is_file():
            yield Findings(inner.name, inner.name, tables, _pictures(inner, ""))
    documents = {file.stem: file for file in sorted(folder.glob("*.json"))}
    for stem, file in documents.items():
        others = [other for other in documents if other != stem]
        beside = {
            **_pictures(folder.parent / "pictures", stem, others),
            **_pictures(folder, stem, others),
        }
        yield Findings(stem, stem, file, beside)


def _pictures(folder: Path, stem: str, others: Iterable[str] = ()) -> dict[str, Path]:
    """Those that begin with a name, and not with a longer one of the others.

    Of one in several formats the first.
    """
    longer = tuple(other for other in others if other.startswith(stem))
    chosen: dict[str, Path] = {}
    for suffix in PICTURES:
        for file in sorted(folder.glob(f"{stem}*{suffix}")):
            if not file.stem.startswith(longer):
                chosen.setdefault(file.stem, file)
    return {file.name: file for file in chosen.values()}


def _markdown(text: str) -> Iterator[Table]:
    """The pipe tables of a Markdown text; the first cell of the head is the title."""
    block: list[list[str]] = []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            block.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif block:
            title, *head = block[0]
            rows = [row for row in block[1:] if not all(set(cell) <= set("-: ") for cell in row)]
            yield {"title": title, "head": ["", *head], "rows": rows}
            block = []


def _document(document: Mapping[str, Any]) -> Iterator[Table]:
    """Means and spreads: a table for each figure, variant and control; methods over motions.

    A document of another kind brings its tables as Markdown.
    """
    if "markdown" in document:
        yield from _markdown(document["markdown"])
        return
    means, titles = document["means"], document.get("titles", {})
    keys = [(row["figure"], row["variant"], row["control"]) for row in means]
    for key in dict.fromkeys(keys):
        cells = {
            (row["method"], row["n_new"]): row
            for row, its in zip(means, keys, strict=True)
            if its == key
        }
        counts = sorted({n_new for _, n_new in cells})
        methods = dict.fromkeys(method for method, _ in cells)
        figure, variant, control = key
        yield {
            "title": f"{_titled(figure, titles)} · {variant} · control {control}",
            "head": ["method", *(f"N={n}" if n else "any N" for n in counts)],
            "rows": [[m, *(_cell(cells.get((m, n))) for n in counts)] for m in methods],
        }
    claims = [row for row in document.get("orderings", ()) if row["claim"]]
    if claims:
        yield {
            "title": "orderings that the paper claims",
            "head": ["claim", "figure", "variant", "control", "N", "verdict"],
            "rows": [[str(row[name]) for name in _ORDERING] for row in claims],
        }


_ORDERING = ("claim", "figure", "variant", "control", "n_new", "verdict")


def _titled(figure: str, titles: Mapping[str, str]) -> str:
    if figure in titles:
        return titles[figure]
    for suffix, unit in _UNITS.items():
        if figure.endswith(suffix):
            return f"{figure.removesuffix(suffix).replace('_', ' ')} [{unit}]"
    return figure.replace("_", " ")


def _cell(row: Mapping[str, Any] | None) -> str:
    if row is None or row["mean"] is None:
        return ""
    mean, sd = row["mean"], row["sd"]
    digits = _decimals(mean, 3)
    if sd is None:
        return f"{mean:.{digits}f}"
    digits = max(digits, min(_decimals(sd, 1), digits + 2))
    return f"{mean:.{digits}f} ± {sd:.{digits}f}"


def _decimals(value: float, digits: int) -> int:
    """How many stand behind the point when so many digits count."""
    return max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
