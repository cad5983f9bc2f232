"""Which processes a robot has: read off its robot file, in the order in which they start."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import cache

from runtime.backoff import Restart
from runtime.settings import RobotSettings
from runtime.suggestion import meant

ENTRY_POINTS = "myograft.processes"

# Nice level of who only looks on or learns: of a processor that control keeps busy they get a
# quarter. At 10 it is a tenth, and relearning starves on a robot that keeps two processors busy.
UNHURRIED = 5


@dataclass(frozen=True, slots=True)
class Spec:
    """One process of a group."""

    process: str  # also the entry point's name, up to a `-`
    restart: Restart = Restart.ALWAYS
    nice: int = 0  # see priority.py
    awaited: bool = False  # somebody waits for it at the start: it steps back once it is ready
    entry: str = ""  # `module:function`, where it is not the entry point of that name


def declared(process: str) -> str:
    """Where `driver-arm` begins, by the entry point `driver`: `module:function`.

    Raises:
        LookupError: no entry point has that name.
    """
    kind = process.partition("-")[0]
    try:
        return _declared()[kind]
    except KeyError:
        raise LookupError(
            f"no process is called {kind!r} in the entry points {ENTRY_POINTS}: "
            "install the package that declares it anew"
        ) from None


@cache
def _declared() -> dict[str, str]:
    from importlib.metadata import entry_points  # 60 ms, which only the supervisor needs to spend

    return {entry.name: entry.value for entry in entry_points(group=ENTRY_POINTS)}


def simulated(settings: RobotSettings) -> bool:
    """Some chain of the robot is simulated: then there is a world, and it owns robot time."""
    return any(chain.link.startswith("sim:") for chain in settings.chain)


def processes_of(settings: RobotSettings) -> tuple[Spec, ...]:
    """The world first, then the drivers, then who listens to them."""
    world = (Spec("world"),) if simulated(settings) else ()
    drivers = tuple(Spec(f"driver-{chain.name}") for chain in settings.chain)
    return (
        *world,
        *drivers,
        Spec("recorder", Restart.ON_FAILURE, nice=UNHURRIED),  # early, so that it is stopped late
        Spec("estimator"),
        Spec("executive"),
        Spec("retrainer", nice=UNHURRIED, awaited=True),  # no schema, no control
        *(
            (Spec("web", Restart.ON_FAILURE, nice=UNHURRIED, awaited=True),)
            if can_serve_page()
            else ()
        ),
        *((Spec("viz", Restart.ON_FAILURE, nice=UNHURRIED),) if can_view() else ()),
    )


def can_view() -> bool:
    """Rerun is installed (the extra `view`)."""
    return importlib.util.find_spec("rerun") is not None


def can_serve_page() -> bool:
    """A web server is installed (the extra `web`)."""
    return all(importlib.util.find_spec(name) is not None for name in ("starlette", "uvicorn"))


def chosen(specs: tuple[Spec, ...], only: tuple[str, ...]) -> tuple[Spec, ...]:
    """Those that `only` names, in the order of start; all when it names none.

    Raises:
        ValueError: it names one that the robot does not have.
    """
    names = [spec.process for spec in specs]
    unknown = [name for name in only if name not in names]
    if unknown:
        hint = meant(unknown[0], names) or "."
        raise ValueError(f"no process {unknown[0]!r}{hint} This robot has {', '.join(names)}")
    return tuple(spec for spec in specs if not only or spec.process in only)
