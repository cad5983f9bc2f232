"""Progress bars for long work: on a terminal they move, in a log they are a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Narrate = Callable[[str, int, int], None]  # what is being done, step, steps
_LOG_EVERY_S = 60.0


class Pace:
    """How long the rest takes, if it goes on as it went since this was made.

    Steps that were done before do not count: a sweep that goes on where it was knows nothing yet.
    """

    def __init__(self, step: int, now_s: float) -> None:
        self._first_step, self._first_s = step, now_s
        self._last_step, self._last_s = step, now_s

    def see(self, step: int, now_s: float) -> None:
        """So far it is by now."""
        if step != self._last_step:
            self._last_step, self._last_s = step, now_s

    def left_s(self, steps: int, now_s: float) -> float | None:
        """Seconds left of `steps`; None as long as nothing is known."""
        done = self._last_step - self._first_step
        if done <= 0:
            return None
        each_s = (self._last_s - self._first_s) / done
        return max(0.0, each_s * (steps - self._last_step) - (now_s - self._last_s))


@contextmanager
def bars() -> Iterator[Narrate]:
    """Gives a function that shows how far each titled piece of work is."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.text import Text

    paces: dict[str, Pace] = {}
    if not sys.stderr.isatty():
        said_s = time.monotonic()

        def say(title: str, step: int, steps: int) -> None:
            nonlocal said_s
            now_s = time.monotonic()
            if title not in paces:
                paces[title] = Pace(step, now_s)
                print(f"  {title} ...", file=sys.stderr, flush=True)
                said_s = now_s
            paces[title].see(step, now_s)
            if now_s - said_s >= _LOG_EVERY_S:
                left = _clock(paces[title].left_s(steps, now_s))
                print(f"  {title} {step}/{steps}, {left} left", file=sys.stderr, flush=True)
                said_s = now_s

        yield say
        return

    class Left(ProgressColumn):
        """Rich's own looks back 30 s only, in which a long step does not end."""

        def render(self, task: Task) -> Text:
            if task.finished:
                return Text("done", style="progress.remaining")
            left_s = paces[task.description].left_s(int(task.total or 0), time.monotonic())
            return Text(f"{_clock(left_s)} left", style="progress.remaining")

    tasks: dict[str, TaskID] = {}
    with Progress(
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        Left(),
        console=Console(stderr=True),
    ) as progress:

        def show(title: str, step: int, steps: int) -> None:
            now_s = time.monotonic()
            if title not in tasks:
                paces[title] = Pace(step, now_s)
                tasks[title] = progress.add_task(title, total=steps)
            elif progress.tasks[tasks[title]].finished and step < steps:  # the same once more
                paces[title] = Pace(step, now_s)
                progress.reset(tasks[title])
            paces[title].see(step, now_s)
            progress.update(tasks[title], completed=step, total=steps)

        yield show


def _clock(seconds: float | None) -> str:
    if seconds is None:
        return "-:--:--"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
