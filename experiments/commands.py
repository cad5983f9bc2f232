"""The `myograft demo` command."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command is listed without importing what it runs
    from experiments.score import Score
    from experiments.sequence import Result, Trace
    from experiments.session import Session
    from runtime.settings import RobotSettings

PAPER = {  # robot -> figure -> what the paper has
    "elbow": {"e_theta_rad": "0.0214 -> 0.0245", "sigma_f_n": "7.74 -> 3.54"},
    "musashi_arm": {"e_theta_rad": "0.526 -> 0.329"},
    "musashi_w": {"role_peak_n": "215 -> 118"},
}


class Demo:
    """Run a task, plug in a muscle, let the robot learn it, run the task again.

    Starts a new robot's process group, runs the robot file's first task, plugs the spare muscle
    into the running daisy chain, lets the robot take it in and relearn its body schema, runs the
    task again, and parks. Ends with a table, a recording (.rrd) and a picture (.png).

    Examples:
      myograft demo
      myograft demo musashi_arm        five joints reach ten targets
      myograft demo musashi_w          two arms, a dumbbell goes from one table to another
      myograft demo --view             watch it live in Rerun
      myograft demo --speed 2          robot time twice as fast as wall time
      myograft demo --seed 3 --json result.json
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Arguments."""
        parser.add_argument("robot", nargs="?", default="elbow", help="robot or robot file")
        parser.add_argument("--name", default="", help="another name than the robot file's")
        parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
        parser.add_argument("--picture", type=Path, metavar="PNG", help="put a copy of it there")
        parser.add_argument("--view", action="store_true", help="open the live Rerun view")
        parser.add_argument("--speed", type=float, default=1.0, help="robot time over wall time")
        parser.add_argument(
            "--seed", type=int, default=0, help="noise, motions, and where the muscle is fixed"
        )

    def run(self, args: argparse.Namespace) -> int:
        """Run it; 0 when the robot grew."""
        from experiments.session import SessionError
        from runtime.bus import BusError
        from runtime.cli.main import UsageError
        from runtime.hubs import HubError
        from runtime.settings import SettingsError

        if not 0.05 <= args.speed <= 20.0:
            print("myograft demo: --speed is from 0.05 to 20", file=sys.stderr)
            return 2
        try:
            return _demo(args)
        except SettingsError as error:
            raise UsageError(str(error)) from error
        except (SessionError, HubError, BusError) as error:
            print(f"myograft demo: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print("\nmyograft demo: interrupted; the robot was stopped", file=sys.stderr)
            return 130


def _demo(args: argparse.Namespace) -> int:
    from experiments.live import live_session
    from experiments.progress import bars
    from experiments.sequence import Trace, run_sequence
    from runtime.hubs import new_run_dir
    from runtime.settings import load_robot

    settings = load_robot(args.robot, args.name)
    if not settings.spare:
        print(f"{settings.file}: no [[spare]] to plug in; add one", file=sys.stderr)
        return 2
    if not settings.task:
        print(f"{settings.file}: no [[task]] to run; add one", file=sys.stderr)
        return 2
    run_dir = new_run_dir(settings.name)
    trace = Trace(settings)
    start = time.monotonic()
    with ExitStack() as stack:
        session = stack.enter_context(
            live_session(
                settings,
                speed=args.speed,
                seed=args.seed,
                run_dir=run_dir,
                state_dir=run_dir / "state",
                say=print,
            )
        )
        print(
            f"'{settings.name}' is up after {time.monotonic() - start:.1f} s: "
            f"{len(settings.muscles)} muscles on its daisy chain, recording in {run_dir}",
            flush=True,
        )
        if args.view:
            _open_view(session, stack)
        narrate = stack.enter_context(bars())
        result = run_sequence(session, trace, narrate)
    recording = next(iter(sorted(run_dir.glob("*.rrd"))), None)
    picture = _draw(settings, run_dir, trace, result)
    figures = {
        "before": _figures(result.before),
        "after": _figures(result.after),
        "n_new": result.n_new,
        "plug_to_resumed_s": round(result.plug_to_resumed_s, 3),
        "relearn_s": round(result.relearn_s, 3),
        "recording": str(recording or ""),
        "summary_png": str(picture),
    }
    report = _report(settings, result, figures, time.monotonic() - start)
    print("", *report, sep="\n")
    print(f"recording                    {figures['recording']}")
    print(f"picture                      {figures['summary_png']}")
    if args.picture:
        shutil.copyfile(picture, args.picture)
    if args.json:
        args.json.write_text(json.dumps({**figures, "report": report}, indent=2) + "\n")
    return 0


def _figures(score: Score) -> dict[str, float]:
    return {name: round(value, 5) for name, value in asdict(score).items()}


def _rows(settings: RobotSettings, result: Result) -> list[tuple[str, ...]]:
    before, after = result.before, result.after
    paper = PAPER.get(Path(settings.file).stem, {})

    def row(name: str, unit: str, field: str, digits: int) -> tuple[str, ...]:
        b, a = getattr(before, field), getattr(after, field)
        return (
            f"{name} [{unit}]",
            f"{b:.{digits}f}",
            f"{a:.{digits}f}",
            f"{a / b:.2f}",
            paper.get(field, ""),
        )

    rows = [
        ("", "before", "after", "ratio", "paper"),
        row("E_theta", "rad", "e_theta_rad", 4),
        row("sigma_f", "N", "sigma_f_n", 2),
        row("peak tension", "N", "peak_tension_n", 1),
    ]
    if settings.role:
        rows.append(row("peak in role", "N", "role_peak_n", 1))
    return rows


def _report(
    settings: RobotSettings, result: Result, figures: dict[str, Any], wall_s: float
) -> list[str]:
    """What is told of it, line by line."""
    limits, rows = settings.module, _rows(settings, result)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        first = row[0].ljust(widths[0])
        rest = "   ".join(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))
        lines.append(f"{first}   {rest}".rstrip())
    return [
        *lines,
        "",
        f"from plug to resumed motion  {figures['plug_to_resumed_s']:.1f} s of robot time",
        f"relearning                   {figures['relearn_s']:.1f} s, {figures['n_new']} motions",
        f"greatest true tension        {result.peak_tension_n:.0f} N at any instant, "
        f"{limits.tension_limit_n:.0f} N are allowed",
        f"fastest commanded length     {result.peak_target_speed_m_s:.2f} m/s, "
        f"the motors wind {limits.winding_speed_m_s:.2f} m/s",
        f"everything                   {wall_s:.0f} s of wall time",
    ]


def _draw(settings: RobotSettings, run_dir: Path, trace: Trace, result: Result) -> Path:
    from dashboard.summary import draw_summary

    path = run_dir / "summary.png"
    rows = [row[:3] for row in _rows(settings, result)]
    draw_summary(
        path,
        time_s=trace.time_s,
        angle_deg=trace.angle_deg,
        tension_n=trace.tensions(),
        marks=trace.marks,
        table=rows,
        added=[settings.spare[0].name],
        title=f"{settings.name}: a muscle is added while the robot runs",
    )
    return path


def _open_view(session: Session, stack: ExitStack) -> None:
    from dashboard.viewer import ViewerError, open_view
    from runtime.messages import Event, Message

    def announced(message: Message) -> bool:
        return isinstance(message, Event) and message.kind == "viewer"

    event = session.wait(announced, 20.0, "the viz process announcing its view")
    assert isinstance(event, Event)
    try:
        viewer = stack.enter_context(open_view(event.data["url"]))
    except ViewerError as error:
        print(f"myograft demo: no view: {error}", file=sys.stderr)
        return
    if viewer.address:
        print(f"watch it at {viewer.address}", flush=True)
