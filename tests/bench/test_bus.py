"""Budget: how old a chain state is when its reader has it, over the raw Zenoh hop of the same run.

Sender and reader are processes of their own; the monotonic clock is one for both.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import zenoh

from runtime.bus import Bus
from runtime.hubs import free_endpoint
from runtime.messages import ChainState

COUNT = 1000
PERIOD_S = 0.005
LIMIT_MS = {50: 0.5, 99: 2.0}

SENDER = """
import sys, time
from runtime.bus import Bus
from runtime.envelope import encode
from runtime.messages import ChainState

def state():
    v = tuple(float(i) for i in range(11))
    names = tuple(f"muscle_{i}" for i in range(11))
    return ChainState(stamp_ns=time.monotonic_ns(), chain="arm", muscles=names, length_m=v,
        tension_n=v, temperature_degc=v, target_length_m=v, mode="hold")

count, period_s = int(sys.argv[2]), float(sys.argv[3])
with Bus("bench", "sender", endpoint=sys.argv[1]) as bus:
    raw = bus._session.declare_publisher("bench/raw")
    payload = encode(state())
    time.sleep(0.5)
    due = time.monotonic()
    for _ in range(count):
        bus.publish(state())
        time.sleep(max(0.0, due + period_s / 2 - time.monotonic()))
        raw.put(time.monotonic_ns().to_bytes(8, "little") + payload)
        due += period_s
        time.sleep(max(0.0, due - time.monotonic()))
"""


def test_age_of_a_chain_state() -> None:
    endpoint = free_endpoint()
    ages_ms: list[float] = []
    raw_ms: list[float] = []
    over = threading.Event()

    def arrived(sample: zenoh.Sample) -> None:
        sent_ns = int.from_bytes(bytes(sample.payload)[:8], "little")
        raw_ms.append((time.monotonic_ns() - sent_ns) / 1e6)

    switch_s = sys.getswitchinterval()
    sys.setswitchinterval(0.0005)  # as every process of a robot does
    with Bus("bench", "reader", listen=endpoint) as bus:
        bus.subscribe(ChainState)
        raw = bus._session.declare_subscriber("bench/raw", arrived)
        command = [sys.executable, "-c", SENDER, endpoint, str(COUNT), str(PERIOD_S)]
        with subprocess.Popen(command) as sender:
            threading.Thread(target=lambda: (sender.wait(), over.set()), daemon=True).start()
            while not over.is_set():
                for state in bus.wait(0.1):
                    assert isinstance(state, ChainState)
                    ages_ms.append((time.monotonic_ns() - state.stamp_ns) / 1e6)
        raw.undeclare()
    sys.setswitchinterval(switch_s)
    assert len(ages_ms) > 0.95 * COUNT
    print()
    for percent, limit_ms in LIMIT_MS.items():
        age, hop = np.percentile(ages_ms, percent), np.percentile(raw_ms, percent)
        print(f"p{percent}: state {age:.3f} ms, raw hop {hop:.3f} ms, over it {age - hop:.3f} ms")
        assert age - hop < limit_ms
