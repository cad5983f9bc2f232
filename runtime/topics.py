"""The table: message type -> key, rate, how long it is kept. Key strings exist nowhere else."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from runtime import messages as m


class Keep(Enum):
    """What a subscriber that is slow or late gets."""

    LATEST = "latest"  # one slot: a slow reader sees the newest only
    QUEUE = "queue"  # every sample in order, from when it subscribed
    RETAINED = "retained"  # like LATEST, and a late subscriber gets the last one
    HISTORY = "history"  # like QUEUE, and a late subscriber gets the last fifty


class Topic(NamedTuple):
    """One row: `{fields}` in the key are filled from the message's own fields."""

    message: type[m.Message]
    key: str
    rate_hz: float = 0.0  # per robot second; 0: when something happens
    keep: Keep = Keep.LATEST


class Request(NamedTuple):
    """One row: a query on `key` carrying `message`, answered with a `Reply`."""

    message: type[m.Message]
    key: str
    timeout_s: float = 5.0


TOPICS = (
    Topic(m.Clock, "clock", 100),
    Topic(m.BusRequest, "chain/{chain}/rx", 400, Keep.QUEUE),
    Topic(m.BusReply, "chain/{chain}/tx", 400, Keep.QUEUE),
    Topic(m.ChainBody, "chain/{chain}/body", 0, Keep.RETAINED),
    Topic(m.ChainState, "chain/{chain}/state", 200),
    Topic(m.ChainCommand, "chain/{chain}/command", 100),
    Topic(m.HandCommand, "hand/{hand}/command", 0, Keep.RETAINED),
    Topic(m.HandState, "hand/{hand}/state", 0, Keep.RETAINED),
    Topic(m.JointState, "joint/{source}/state", 200),
    Topic(m.JointEstimate, "joint/estimate", 100),
    Topic(m.SchemaVersion, "schema", 0, Keep.RETAINED),
    Topic(m.SchemaCandidate, "schema/candidate", 0, Keep.RETAINED),
    Topic(m.SchemaVerdict, "schema/verdict", 0, Keep.RETAINED),
    Topic(m.TrainingJob, "training/job", 0, Keep.RETAINED),
    Topic(m.TrainingProgress, "training/progress", 0),
    Topic(m.ExecutiveState, "executive/state", 50),
    Topic(m.Event, "event", 0, Keep.HISTORY),
    Topic(m.Health, "health/{process}", 1, Keep.RETAINED),
    Topic(m.GroupState, "group", 1, Keep.RETAINED),
    Topic(m.Steps, "steps/{process}", 4, Keep.HISTORY),
    Topic(m.WorldTruth, "world/truth", 200),
)

REQUESTS = (
    Request(m.Plug, "request/plug"),
    Request(m.Unplug, "request/unplug"),
    Request(m.Reach, "request/reach"),
    Request(m.Task, "request/task"),
    Request(m.Estop, "request/estop"),
    Request(m.Reset, "request/reset"),
    Request(m.Relearn, "request/relearn"),
    Request(m.SchemaRequest, "request/schema"),
    Request(m.Identify, "chain/{chain}/identify"),
    Request(m.Fault, "request/fault"),
)

TOKEN_KEY = "token/{process}"  # liveliness: stands while the process lives

BY_TYPE: dict[type[m.Message], Topic] = {topic.message: topic for topic in TOPICS}
BY_NAME: dict[str, Topic] = {topic.message.__name__: topic for topic in TOPICS}
REQUEST_BY_TYPE: dict[type[m.Message], Request] = {row.message: row for row in REQUESTS}


def key_of(robot: str, message: m.Message) -> str:
    """The full key a message is published or asked on: robot first, fields filled in."""
    row = BY_TYPE.get(type(message)) or REQUEST_BY_TYPE[type(message)]
    return f"{robot}/{row.key}".format_map(_Fields(message))


def key_pattern(robot: str, kind: type[m.Message], chain: str = "*") -> str:
    """The key expression that matches every message of one type: `elbow/chain/*/state`.

    `chain` narrows it to what concerns one chain, where a key tells.
    """
    row = BY_TYPE.get(kind) or REQUEST_BY_TYPE[kind]
    return f"{robot}/{row.key.format_map(_Wild(chain=chain))}"


class _Wild(dict[str, str]):
    def __missing__(self, name: str) -> str:
        return "*"


class _Fields(dict[str, str]):
    def __init__(self, message: m.Message) -> None:
        self.message = message

    def __missing__(self, name: str) -> str:
        return str(getattr(self.message, name))
