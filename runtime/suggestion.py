"""What a person may have meant by a name that is not there."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

FEW = 12  # names that a sentence lists


def meant(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'biceps_1'?`, or nothing if no name is near."""
    close = difflib.get_close_matches(word, sorted(known), n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


def suggestion(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'biceps_1'?`, or what there is to choose from."""
    names = sorted(known)
    few = ", ".join(names[:FEW]) + (", ..." if len(names) > FEW else "")
    return meant(word, names) or (f"; there is {few}" if names else "; there is none")
