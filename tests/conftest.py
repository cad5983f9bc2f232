"""For all tests: properties are tried on the same examples in every run, however slow the machine.

A fresh checkout builds tables of characters first, which a health check would take for slowness.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile(
    "myograft", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("myograft")
