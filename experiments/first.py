"""The `myograft learn` command: a robot's first body schema, learned by the robot itself."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command is listed without importing what it runs
    from experiments.progress import Narrate
    from experiments.session import Session
    from runtime.messages import Message, SchemaVersion
    from runtime.settings import RobotSettings

POSTURES = 200  # that are asked whether they can be held
MOTION_S = 60.0  # of robot time, at most, for one; and for everything around them:
AROUND_S = 300.0
OVER = ("grow_done", "grow_failed", "growth_given_up", "learning_paused")


class Learn:
    """Let a robot learn its body schema by moving.

    A robot that has none begins by the wires that its body file draws. It moves through its joints'
    ranges, its targets following what lengths are felt to be off by; wires are fitted to the
    motions, the network is taught by them, and what came out is tried on motions that were not
    learned from. Starts the robot unless it runs, and parks it again. Ctrl-C parks it, too, and
    the same command goes on where it was. A robot that has a schema refines it.

    Examples:
      myograft learn my_arm.toml
      myograft learn my_arm.toml --motions 25 --json learned.json
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Arguments."""
        parser.add_argument("robot", help="robot or robot file")
        parser.add_argument("--name", default="", help="another name than the robot file's")
        parser.add_argument(
            "--motions", type=int, metavar="N", help="to learn from; default: the file's n_new"
        )
        parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
        parser.add_argument("--speed", type=float, default=1.0, help="robot time over wall time")
        parser.add_argument("--seed", type=int, default=0, help="of everything random")

    def run(self, args: argparse.Namespace) -> int:
        """Learn; 0 when a schema was adopted."""
        from experiments.session import SessionError
        from runtime.bus import BusError
        from runtime.cli.main import UsageError
        from runtime.hubs import HubError
        from runtime.settings import SettingsError, load_robot

        if not 0.05 <= args.speed <= 20.0:
            raise UsageError("--speed is from 0.05 to 20")
        if args.motions is not None and not 1 <= args.motions <= 100:
            raise UsageError("--motions is from 1 to 100")
        try:
            settings = load_robot(args.robot, args.name)
        except SettingsError as error:
            raise UsageError(str(error)) from error
        if not _can_be_held(settings):
            return 1
        try:
            return _learn(settings, args)
        except (SessionError, HubError, BusError) as error:
            print(f"myograft learn: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print("\nmyograft learn: parked; the same command goes on", file=sys.stderr)
            return 130


def _can_be_held(settings: RobotSettings) -> bool:
    from experiments.body import Subject, print_failures, print_feasibility, report

    control = settings.control
    subject = Subject(settings.name, settings.body_file, settings.joints, (), control)
    found = report(subject, subject.geometry(), POSTURES, 0)
    if found["cases"][0]["share"] == 1.0:
        return True
    print_feasibility(found)
    print_failures(found, "learn")
    return False


def _learn(settings: RobotSettings, args: argparse.Namespace) -> int:
    from experiments.live import own_session
    from experiments.progress import bars
    from services.body_schema.schema import Schema

    with (
        own_session(settings, speed=args.speed, seed=args.seed, say=print) as session,
        bars() as narrate,
    ):
        print(f"'{settings.name}' is up; Ctrl-C parks it, the same command goes on", flush=True)
        version = learn_live(session, args.motions or settings.growth.n_new, narrate)
    schema = Schema.from_bytes(version.data)
    network_mm = dict(zip(schema.muscles, (schema.length_sigma_m * 1e3).tolist(), strict=True))
    width = max(map(len, schema.muscles))
    print(f"\n{'':<{width}}  wires, held out [mm]  network, learned from [mm]")
    for name in schema.muscles:
        held_mm = version.residual_mm.get(name)
        word = "slack" if held_mm is None else f"{held_mm:.2f}"
        print(f"{name:<{width}}  {word:>20}  {network_mm[name]:>26.2f}")
    file = _shipped(settings, version.data)
    print(f"\nschema version {version.version} is in use" + (f", and in {file}" if file else ""))
    if args.json:
        figures = {
            "robot": settings.name,
            "version": version.version,
            "held_out_mm": version.residual_mm,
            "network_mm": network_mm,
            "schema": str(file or ""),
        }
        args.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


def learn_live(session: Session, motions: int, narrate: Narrate) -> SchemaVersion:
    """Ask for it, unless it is under way, and wait for its end.

    Raises:
        SessionError: the robot refused, or gave up.
    """
    from experiments.sequence import GrowthProgress
    from experiments.session import SessionError
    from runtime import messages as m
    from services.logic.arm import NO_SCHEMA

    versions: list[m.SchemaVersion] = []

    def see(message: Message) -> None:
        if isinstance(message, m.SchemaVersion):
            versions.append(message)

    session.watchers += [see, GrowthProgress(narrate).see]
    stored = session.ask(m.SchemaRequest(action="list")).data.values()
    knows = any(words.startswith("active") for words in stored)

    def ready(message: Message) -> bool:
        if not isinstance(message, m.ExecutiveState):
            return False
        unlearned = not knows and message.text == NO_SCHEMA
        return unlearned or bool(message.growing) or message.stage == "hold"

    state = session.wait(ready, 60.0, "the arm holding")
    assert isinstance(state, m.ExecutiveState)
    if not state.growing:
        session.ask(m.Relearn(n_new=motions))

    def over(message: Message) -> bool:
        ended = isinstance(message, m.Event) and message.kind in OVER
        return ended and message.stamp_ns >= state.stamp_ns

    done = session.wait(over, AROUND_S + MOTION_S * motions, "the schema")
    assert isinstance(done, m.Event)
    if done.kind != "grow_done":
        raise SessionError(done.text)
    return versions[-1]


def _shipped(settings: RobotSettings, data: bytes) -> Path | None:
    """Where the schema now stands beside the robot file; one that is there is left as it is."""
    file = settings.schema_file
    if file is None or file.exists():
        return None
    file.parent.mkdir(parents=True, exist_ok=True)
    whole = file.with_name(file.name + ".new")
    whole.write_bytes(data)
    return whole.replace(file)
