"""Every message that crosses the bus: in SI units unless a field's name says otherwise.

A message is a frozen `msgspec.Struct`. Its `stamp_ns` is robot time (see `clock.py`). Which key it
travels on, how often, and how long it is kept stands in `topics.py`, one row a type.
Muscles and joints are matched by name, never by position.
"""

from __future__ import annotations

import msgspec

METHODS = ("i", "ii", "iii", "iv")  # of relearning: the paper's three, and by wires


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Anything that travels on the bus."""

    stamp_ns: int = 0  # robot time; of readings, when they were asked for


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """What a request is answered with: whether it was done, and in words what really happened."""

    ok: bool  # it was done
    text: str = ""  # in words, for a person
    data: dict[str, str] = {}  # for scripts; `process` is who answered


# ── time and processes ────────────────────────────────────────────────────────────────────────


class Clock(Message, frozen=True, kw_only=True):
    """Robot time as the world tells it. On a real robot nobody sends it."""

    speed: float  # robot seconds per wall second that is asked for
    real_time_factor: float  # robot seconds per wall second that is reached
    incarnation: int  # grows by one each time the world comes back


class Presence(Message, frozen=True, kw_only=True):
    """A process's liveliness token came or went. Made by the bus, never published."""

    process: str
    alive: bool


class Health(Message, frozen=True, kw_only=True):
    """How one process does, once a second of wall time."""

    process: str  # `estimator`, `driver-arm`, ...
    pid: int
    tick_hz: float  # ticks per robot second
    cpu_percent: float  # of one core
    memory_mb: float  # resident
    dropped: int  # messages that were malformed, foreign, newer, stale or too many, since start
    rates_hz: dict[str, float] = {}  # message type -> received per robot second
    hears: tuple[str, ...] = ()  # the robot's processes whose liveliness tokens it sees, sorted


class ProcessRow(msgspec.Struct, frozen=True, kw_only=True):
    """One process as the supervisor sees it."""

    process: str
    state: str  # starting | ready | backoff | failed | stopped
    pid: int = 0
    restarts: int = 0
    last_exit: str = ""  # how it ended when it last did


class GroupState(Message, frozen=True, kw_only=True):
    """The supervisor's table of its processes."""

    ready: bool  # all processes are
    run_dir: str  # logs and recordings, on the robot's host
    processes: tuple[ProcessRow, ...]


class Event(Message, frozen=True, kw_only=True):
    """Something that happened once and that a person wants to read."""

    process: str  # who tells it
    level: str  # info | warning | error
    kind: str  # a stable word for scripts: plugged, joined, adopted, process_died, ...
    text: str
    data: dict[str, str] = {}


class Steps(Message, frozen=True, kw_only=True):
    """What a process's logic took in and when it acted: thus a recording can be led through it."""

    process: str
    begin: int  # steps of this process before these; 0: they begin with its start
    tick_ns: tuple[int, ...]  # robot time of each step: it takes in what there is, then acts
    taken: tuple[int, ...]  # how many messages each step took in
    keys: tuple[str, ...]
    heard_key: tuple[int, ...]  # of each message: its place in `keys`
    heard_ns: tuple[int, ...]  # and its stamp


# ── the daisy chains ──────────────────────────────────────────────────────────────────────────


class BusRequest(Message, frozen=True, kw_only=True):
    """Bytes that a chain's master put on the simulated line."""

    chain: str
    sequence: int  # the reply has the same
    data: bytes


class BusReply(Message, frozen=True, kw_only=True):
    """Bytes that a chain's modules put on the simulated line."""

    chain: str
    sequence: int  # the request's
    data: bytes  # empty: nobody answered


class ModuleInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One module of a chain, in the order in which it was met."""

    name: str  # muscle or joint; "" until the module has been given one
    kind: str  # muscle | joint
    module_id: int  # address on the line
    serial: int  # unique, for ever
    state: str  # joining | up | lost | fault | stopped
    fault: str = ""  # in words, when state is fault
    tension_limit_n: float = 0.0
    link_errors: int = 0  # answers that were missing or garbled


class ChainBody(Message, frozen=True, kw_only=True):
    """Who is plugged into one chain."""

    chain: str
    modules: tuple[ModuleInfo, ...]


class ChainState(Message, frozen=True, kw_only=True):
    """What one daisy chain's muscles felt at one instant. Shapes: (M,), matched by `muscles`."""

    chain: str
    muscles: tuple[str, ...]
    length_m: tuple[float, ...]  # wire paid out, from the module's length zero
    tension_n: tuple[float, ...]  # at the load cell
    temperature_degc: tuple[float, ...]  # of the motor's winding
    target_length_m: tuple[float, ...]  # what the modules were last told
    mode: str  # follow | hold | stopping | stopped


class JointState(Message, frozen=True, kw_only=True):
    """Joint angles as they were measured: by joint modules, or by whoever else sees them."""

    source: str  # the chain, for joint modules
    joints: tuple[str, ...]
    angle_rad: tuple[float, ...]


class ChainCommand(Message, frozen=True, kw_only=True):
    """What one chain's muscles shall do: f_ref = f_bias + k_stiff (l - l_ref), paper eq. 1."""

    chain: str
    author: str  # drivers obey the executive alone
    lease_ns: int  # robot time for which this stands; afterwards the driver holds
    muscles: tuple[str, ...]
    bias_n: tuple[float, ...]  # f_bias
    stiffness_n_m: tuple[float, ...]  # k_stiff
    target_length_m: tuple[float, ...]  # l_ref


class HandCommand(Message, frozen=True, kw_only=True):
    """What a hand shall hold; with `holds` empty it opens."""

    hand: str  # link of the body
    holds: str  # payload of the robot file


class HandState(Message, frozen=True, kw_only=True):
    """What a hand holds, said in answer to each command."""

    hand: str
    asked: str  # what it was told to hold
    holds: str  # "" when it is open, or closed on nothing


# ── body schema ───────────────────────────────────────────────────────────────────────────────


class JointEstimate(Message, frozen=True, kw_only=True):
    """Joint angles from tension and length alone (mask 011), and what the schema expected."""

    joints: tuple[str, ...]
    angle_rad: tuple[float, ...]
    confidence_rad: tuple[float, ...]  # standard deviation
    muscles: tuple[str, ...]
    predicted_length_m: tuple[float, ...]
    predicted_tension_n: tuple[float, ...]
    anomaly: tuple[float, ...]  # length residual over its usual size; above 3 is odd
    length_error_m: tuple[float, ...] = ()  # felt minus predicted, of the same reading


class Place(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A point of a wire: fixed on a link at a position, or laid around a wrapping geom."""

    link: str = ""  # MJCF body
    position_m: tuple[float, float, float] | None = None  # in the link's frame
    wrap: str = ""  # MJCF geom (cylinder or sphere), instead of link and position
    side: str = ""  # MJCF site on the side of the geom where the wire passes


class MusclePath(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a muscle module sits and how its wire runs: the paper's three hardware requirements."""

    attachment: Place  # (1) where the module is fixed
    direction: tuple[float, float, float]  # (2) where the wire leaves it, in the link's frame
    relays: tuple[Place, ...]  # (3) relay points in order; the last is where the wire ends


class Motion(msgspec.Struct, frozen=True, kw_only=True):
    """One motion as the sensors saw it: T samples of N joints and M muscles, row by row."""

    angle_rad: tuple[tuple[float, ...], ...]  # (T, N)
    tension_n: tuple[tuple[float, ...], ...]  # (T, M)
    length_m: tuple[tuple[float, ...], ...]  # (T, M)
    settled: tuple[bool, ...]  # (T,): sample taken at rest


class SchemaVersion(Message, frozen=True, kw_only=True):
    """The body schema in use, with all that a reader needs to serve it."""

    version: int
    joints: tuple[str, ...]
    muscles: tuple[str, ...]
    method: str  # shipped | i | ii | iii | iv | shrink | refit
    job: str = ""  # the training job that made it
    parent: int = 0  # the version it was made from
    residual_mm: dict[str, float] = {}  # muscle -> length residual on held-out motion
    data: bytes  # safetensors


class VersionRow(msgspec.Struct, frozen=True, kw_only=True):
    """One stored version, as the retrainer lists it: `rows` of its reply, a JSON array of these."""

    version: int
    state: str  # shipped | candidate | adopted | refused
    active: bool
    method: str
    muscles: tuple[str, ...]
    parent: int
    residual_mm: dict[str, float]  # muscle -> length residual on held-out motion
    train_s: float  # wall time that relearning took
    reason: str  # of the verdict


class SchemaCandidate(SchemaVersion, frozen=True, kw_only=True):
    """A relearned schema that nobody uses yet: it waits for held-out motion."""

    train_s: float  # wall time that relearning took


class SchemaVerdict(Message, frozen=True, kw_only=True):
    """The executive's word on a candidate, after held-out motion."""

    job: str  # the candidate's
    adopted: bool
    reason: str
    residual_mm: dict[str, float] = {}  # muscle -> length residual on held-out motion


class TrainingJob(Message, frozen=True, kw_only=True):
    """What the retrainer is asked to do. Stands until a candidate or a failure names it."""

    job: str  # its name
    kind: str  # grow | shrink | refit
    base_version: int  # the schema that it starts from
    joints: tuple[str, ...]
    muscles: tuple[str, ...]  # of the schema that is wanted, in the order of the motions' columns
    method: str = "iv"  # of relearning: i | ii | iii | iv
    seed: int = 0  # of everything random
    motions: tuple[Motion, ...] = ()  # that were collected
    paths: dict[str, MusclePath] = {}  # how added wires nominally run, as far as anybody said


class TrainingProgress(Message, frozen=True, kw_only=True):
    """How far relearning is."""

    job: str
    stage: str  # starting | training | done | failed
    method: str = ""  # of relearning; of another kind of job its kind
    epoch: int = 0
    epochs: int = 0
    loss: float = 0.0  # of all
    loss_new: float = 0.0  # on the new motions
    loss_old: float = 0.0  # on what the old schema says
    text: str = ""  # why, when it failed


# ── executive ─────────────────────────────────────────────────────────────────────────────────


class ExecutiveState(Message, frozen=True, kw_only=True):
    """What the executive is doing and what it wants of the joints."""

    stage: str  # waiting|hold|move|join|collect|relearn|adopt|resume|park|stopped
    task: str = ""  # of the robot file, while one runs
    step: int = 0  # of the task or of the collection, counted from 1
    steps: int = 0
    settled: bool = False  # the arm has come to rest at the step's target
    joints: tuple[str, ...] = ()
    reference_rad: tuple[float, ...] = ()  # where the joints shall be now
    muscles: tuple[str, ...] = ()
    planned_tension_n: tuple[float, ...] = ()  # of the muscles, at that reference
    growing: str = ""  # the muscle being taken in
    schema_version: int = 0  # in use; 0: none
    text: str = ""  # what it waits for, or why


# ── requests ──────────────────────────────────────────────────────────────────────────────────


class Plug(Message, frozen=True, kw_only=True):
    """Extend a chain at its tail by one muscle module."""

    muscle: str
    chain: str = ""  # "": the spare's, or the only one
    path: MusclePath | None = None  # None: the spare of that name in the robot file
    module_id: int = 1  # 1 as it comes from the factory


class Unplug(Message, frozen=True, kw_only=True):
    """Take a muscle's module off its chain."""

    muscle: str


class Reach(Message, frozen=True, kw_only=True):
    """Move the joints to a posture and hold it."""

    angle_rad: dict[str, float]  # joint -> angle; joints that are not named stay


class Task(Message, frozen=True, kw_only=True):
    """Run one of the robot file's tasks; or `park`, `hold`, `cancel`."""

    name: str


class Estop(Message, frozen=True, kw_only=True):
    """Pay out every wire at bounded speed and latch."""

    reason: str = ""  # for the log


class Reset(Message, frozen=True, kw_only=True):
    """Clear a latched stop and hold where the arm is."""


class Relearn(Message, frozen=True, kw_only=True):
    """Collect motions again and relearn the schema."""

    method: str = "iv"  # i | ii | iii | iv
    n_new: int = 7  # motions to collect


class SchemaRequest(Message, frozen=True, kw_only=True):
    """Ask the retrainer about its versions: `list`, or `rollback` to a version."""

    action: str  # list | rollback
    version: int = 0  # to go back to


class Identify(Message, frozen=True, kw_only=True):
    """Let one module of a chain blink its LED, so that a person finds it."""

    chain: str
    module: str  # name of its muscle or joint


class Fault(Message, frozen=True, kw_only=True):
    """Break something in the simulation, mend it, or list what is broken."""

    kind: str = ""  # corrupt | drop | delay | cable | stuck | rupture | overheat; "" mends any
    target: str = ""  # muscle, joint or chain; "" mends any
    amount: float = 0.0
    action: str = "break"  # break | mend | list


# ── simulation's truth, for scoring only ──────────────────────────────────────────────────────


class WorldTruth(Message, frozen=True, kw_only=True):
    """What really is. No service subscribes to this: only experiments and tests, to score."""

    joints: tuple[str, ...]
    angle_rad: tuple[float, ...]
    muscles: tuple[str, ...]
    tension_n: tuple[float, ...]  # at the load cell
    length_m: tuple[float, ...]
    peak_tension_n: tuple[float, ...]  # greatest at any 1 ms step since the world's first start
    peak_speed_m_s: tuple[float, ...]  # greatest winding or paying-out speed, likewise
    peak_target_speed_m_s: tuple[float, ...]  # fastest that a module's target length moved
