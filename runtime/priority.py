"""Who gets the processor first: the robot's own processes, before those that learn or only look.

Nice alone does not say so. Where Linux groups processes by session (autogroup, the default of most
distributions) a nice level counts within a session only, and each child has a session of its own:
so the session steps back as well. And who steps back takes the processor from nobody by waking up
(SCHED_BATCH).
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path

_PAUSE_S = 0.11  # Linux takes one such wish in a tenth of a second from who is not root
_TRIES = 50


def step_back(pid: int, nice: int) -> None:
    """Lower the priority of a process that leads a session, and of its threads. Never waits.

    Args:
        pid: the process; gone is no mistake.
        nice: 1 to 19, the highest is the last to be served.
    """
    for thread in _threads(pid):
        with contextlib.suppress(ProcessLookupError):
            os.setpriority(os.PRIO_PROCESS, thread, nice)
            os.sched_setscheduler(thread, os.SCHED_BATCH, os.sched_param(0))
    threading.Thread(target=_lower_session, args=(pid, nice), daemon=True).start()


def _threads(pid: int) -> list[int]:
    with contextlib.suppress(FileNotFoundError):
        return [int(name) for name in os.listdir(f"/proc/{pid}/task")]
    return []


def _lower_session(pid: int, nice: int) -> None:
    for _ in range(_TRIES):
        try:
            Path(f"/proc/{pid}/autogroup").write_text(str(nice))
            return
        except BlockingIOError:
            time.sleep(_PAUSE_S)
        except OSError:  # this kernel does not group by session, or the process is gone
            return
