"""Progress bars for long work: on a terminal they move, in a log each title is one line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Narrate = Callable[[str, int, int], None]  # what is being done, step, steps


@contextmanager
def bars() -> Iterator[Narrate]:
    """Gives a function that shows how far each titled piece of work is."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    tasks: dict[str, TaskID] = {}
    if not sys.stderr.isatty():

        def say(title: str, step: int, steps: int) -> None:
            if title not in tasks:
                tasks[title] = TaskID(0)
                print(f"  {title} ...", file=sys.stderr, flush=True)

        yield say
        return
    with Progress(
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as progress:

        def show(title: str, step: int, steps: int) -> None:
            if title not in tasks:
                tasks[title] = progress.add_task(title, total=steps)
            progress.update(tasks[title], completed=step, total=steps)

        yield show
