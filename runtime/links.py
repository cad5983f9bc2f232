"""How peers find each other and what they let in: the settings of a Zenoh session, as plain data.

Everyone is a listening peer that connects to the hub, its supervisor, and by gossip to all others:
peers that do not listen never meet. Multicast scouting is off. A lease of one second ends the link
to a peer that stands still, so nothing waits longer than that for anybody.
"""

from __future__ import annotations

from typing import Any

from runtime.topics import TOPICS, Keep, key_pattern

LOOPBACK = "tcp/127.0.0.1:0"
LEASE_MS = 1000


def session_settings(endpoint: str, listen: str, also: tuple[str, ...]) -> dict[str, Any]:
    """Zenoh's keys and their values.

    Args:
        endpoint: the hub to connect to, which must be there; "" is to be the first.
        listen: where to listen; "" is to be a client.
        also: more endpoints to connect to, which need not be there.
    """
    settings: dict[str, Any] = {
        "mode": "peer" if listen else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/delay": 0,  # else opening may take half a second
        "connect/endpoints": [name for name in (endpoint, *also) if name],
        "connect/timeout_ms": 0 if also and not endpoint else 2000,
        "connect/exit_on_failure": bool(endpoint),
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 200,
            "period_increase_factor": 1,
        },
        "transport/link/tx/lease": LEASE_MS,
        "timestamping/enabled": True,  # the publishers' caches need it
    }
    if listen:
        settings["listen/endpoints"] = [listen]
    return settings


def thinning(robot: str, most_hz: float, chains: tuple[str, ...]) -> dict[str, Any]:
    """Take in LATEST topics that are faster only so often.

    Zenoh drops what comes too fast on its own threads, before Python hears of it. It counts by rule
    and link, not by key, so that chains must not share a rule.
    """
    fast = [row for row in TOPICS if row.keep is Keep.LATEST and row.rate_hz > most_hz]
    keys = {key_pattern(robot, row.message, chain): 0 for row in fast for chain in chains or ("*",)}
    rules = [{"key_expr": key, "freq": most_hz} for key in keys]
    return {"downsampling": [{"messages": ["put"], "flows": ["ingress"], "rules": rules}]}
