"""Rows of the page's tables, of what the bus says of one module, process or version each."""

from __future__ import annotations

from urllib.parse import urlsplit

import msgspec

from runtime import messages as m

Row = dict[str, object]


def module_row(module: m.ModuleInfo, standing: str) -> Row:
    """A module; `standing` is what its state does not say of it."""
    told = msgspec.structs.asdict(module)
    return {**told, "serial": f"{module.serial:08x}", "standing": standing}


def process_row(row: m.ProcessRow, health: m.Health | None) -> Row:
    """A process, with its own health and not its predecessor's."""
    if health is not None and health.pid != row.pid:
        health = None
    return {
        "process": row.process,
        "state": row.state,
        "pid": row.pid,
        "restarts": row.restarts,
        "last_exit": row.last_exit,
        "tick_hz": round(health.tick_hz, 0) if health else None,  # NaN stays one
        "cpu_percent": round(health.cpu_percent, 1) if health else None,
        "memory_mb": round(health.memory_mb, 0) if health else None,
        "dropped": health.dropped if health else None,
    }


def version_row(row: m.VersionRow) -> Row:
    """A schema version with its figures."""
    residuals = row.residual_mm.values()
    return {
        **msgspec.structs.asdict(row),
        "mean_mm": round(sum(residuals) / len(residuals), 2) if residuals else None,
        "worst_mm": round(max(residuals), 2) if residuals else None,
        "train_s": round(row.train_s, 1) or None,  # a refit trains nothing
        "usable": row.state in ("shipped", "adopted"),
    }


def words_of_link(link: str) -> str:
    """`sim:` -> simulated, `serial:///dev/ttyUSB0?baud=1000000` -> /dev/ttyUSB0."""
    where = urlsplit(link)
    return "simulated" if where.scheme == "sim" else where.path
