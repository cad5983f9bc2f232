"""What the documents show is done, command by command, as a person would in a clone.

Ports, folders of `/tmp` and hosts are the test's own, and robots are in haste. A command that
`tests.shown` places on a robot is run here: by whom it is about it belongs to one of the chapters.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zenoh

from runtime import messages as m
from runtime.bus import Bus
from runtime.cli.main import DONE, REFUSED, main
from runtime.hubs import ENDPOINT_VARIABLE, find_hub, free_endpoint, living_hubs
from tests.e2e.conftest import PATIENCE_S, Command, Watch
from tests.shown import ELSEWHERE, HOWTOS, ROOT, TUTORIAL, Shown, blocks, shown

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

SPEED = ("--speed", "3")
HASTE = """
[growth]
n_new = 3
n_check = 1
[control]
joint_speed_deg_s = 120.0
settle_s = 0.3
"""
TARGETS = 2  # that are left of each task
TRAINING_S = 180.0  # of wall time, in which it steps back behind all others
FOLLOWS = {  # how a command begins -> events of which one says that it is over
    "plug": ("grow_done", "refit_done"),
    "unplug": ("lost",),
    "fault rupture": ("shrink_done",),
    "fault overheat": ("motor_hot",),
    "schema relearn": ("grow_done",),
    "task": ("task_done",),
    "estop": ("stopped",),
}
ONLY = "myograft up elbow --only --connect"


def about(*robots: str) -> list[Shown]:
    """What is shown to be done with a robot, in the order of reading, each once."""
    live = [x for x in shown() if x.where == "robot" and x.robot in robots and x.form != ONLY]
    firsts: dict[str, Shown] = {}
    for command in live:
        firsts.setdefault(command.text, command)
    return list(firsts.values())


@pytest.fixture(autouse=True)
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which all is done: what documents name of the repository lies in it."""
    shutil.copytree(ROOT / "deploy" / "robots", tmp_path / "deploy" / "robots")
    for name in ("deploy/schemas", "hardware_sim/bodies", "tests/bodies"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(ROOT / name)
    for document in HOWTOS:
        for block in blocks(document):
            if block.language == "xml":
                (tmp_path / re.findall(r"`([\w.]+)`", block.before)[-1]).write_text(block.text)
    hasten(tmp_path / "deploy" / "robots" / "elbow.toml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def hasten(file: Path) -> None:
    """Fewer and faster motions, and tasks of a few targets."""
    text, robot = file.read_text(), tomllib.loads(file.read_text())
    for task in robot["task"]:
        few = f"targets_deg = {task['targets_deg'][:TARGETS]}"
        text = re.sub(r"^targets_deg = \[\n.*?^\]", few, text, count=1, flags=re.M | re.S)
    if "growth" in robot:  # `myograft new` has written both tables
        for table in HASTE.split("[")[1:]:
            name, _, lines = table.partition("]\n")
            for key in tomllib.loads(lines):
                text = re.sub(rf"^{key} = .*\n", "", text, flags=re.M)
            text = text.replace(f"[{name}]\n", f"[{name}]\n{lines}")
    file.write_text(text if "growth" in robot else text + HASTE)


@contextmanager
def running(*words: str, name: str, home: Path | None = None) -> Iterator[tuple[Command, Watch]]:
    """`myograft up`, ready, and someone who watches; ended by Ctrl-C if it still runs."""
    with pytest.MonkeyPatch.context() as patch:
        if home is not None:  # another host
            patch.setenv("XDG_STATE_HOME", str(home))
        up = Command("up", *words)
        try:
            up.wait_line("ready after")
            with Bus(name, "test", endpoint=find_hub(name).endpoint) as bus, Watch(bus) as watch:
                patch.undo()
                yield up, watch
        finally:
            assert up.end() == DONE


def rest(watch: Watch, stage: str) -> None:
    """Wait until the arm has come to rest in that stage."""
    watch.wait_for(
        m.ExecutiveState,
        lambda x: x.stage == stage and (x.settled or stage == "stopped"),
        since=watch.mark(),
        timeout_s=PATIENCE_S,
        what=f"the arm in stage {stage}",
    )


def carry_out(command: Shown, watch: Watch) -> None:
    """Run a command to a robot as a person would, and wait for what it promises."""
    since = watch.mark()
    words = command.words[1:]
    began_s = time.monotonic()
    if command.endless:
        process = Command(*words)
        process.wait_line("")
        assert process.end() in (DONE, 130), str(command)
        return
    assert main(list(words)) == DONE, str(command)
    kinds = next((k for begin, k in FOLLOWS.items() if " ".join(words).startswith(begin)), ())
    if kinds:
        watch.wait_for(
            m.Event, lambda x: x.kind in kinds, since=since, timeout_s=TRAINING_S, what=str(command)
        )
    if words[0] != "down":
        rest(watch, "stopped" if words[0] == "estop" else "hold")
    print(f"{time.monotonic() - began_s:5.1f} s  {command}")


def shell(command: Shown, folder: Path, *more: str) -> None:
    """Run a line as a shell does, `python` and the test's own folder put in."""
    text = command.text.replace("/tmp/", f"{folder}/")
    text = re.sub(r"^python\b", sys.executable, text)
    subprocess.run(" ".join((text, *more)), shell=True, check=True, timeout=2 * PATIENCE_S)


def test_the_tutorial_and_all_others_do_what_they_show(clone: Path) -> None:
    commands = about("elbow")
    first = [x for x in commands if x.document == TUTORIAL and x.ours != "up"]
    *story, last = first
    assert last.ours == "down"
    others = [x for x in commands if x not in first and x.ours not in ("up", "")]
    (process,) = (x for x in commands if x.words[:3] == ("python", "-m", "runtime.process"))
    with running("deploy/robots/elbow.toml", *SPEED, name="elbow") as (up, watch):
        rest(watch, "hold")
        with beside(process, clone, watch):
            for command in (*story, *others):
                carry_out(command, watch)
        adopted = [version.method for version in watch.of(m.SchemaVersion)]
        assert list(dict.fromkeys(adopted)) == ["shipped", "iv", "shrink", "refit"]
        carry_out(last, watch)
        assert up.over() == 0
    assert living_hubs() == []


@contextmanager
def beside(command: Shown, folder: Path, watch: Watch) -> Iterator[None]:
    """The process of the how-to joins a robot that runs, its files put beside those of services."""
    package = folder / "with" / "services"
    (package / "logic").mkdir(parents=True)
    for file in (ROOT / "services").rglob("*.py"):
        beside = package / file.relative_to(ROOT / "services")
        if beside.parent.is_dir():
            beside.symlink_to(file)
    (package / "body_schema").symlink_to(ROOT / "services" / "body_schema")
    for block in blocks(command.document):
        for path in re.findall(r"`(services/[\w/]+\.py)`:$", block.before):
            (folder / "with" / path).write_text(block.text)
    words = [word.replace("/tmp/", f"{folder}/") for word in command.words[1:]]
    words[words.index("--endpoint") + 1] = find_hub("elbow").endpoint
    path = os.pathsep.join((str(folder / "with"), *filter(None, [os.environ.get("PYTHONPATH")])))
    process = subprocess.Popen([sys.executable, *words], env={**os.environ, "PYTHONPATH": path})
    try:
        watch.wait_for(m.Health, lambda x: x.process == "watchman", since=0)
        yield
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()


def test_a_body_of_ones_own_is_learned_and_moves(clone: Path) -> None:
    """From its MJCF to its task; `learn` and `up`, which the how-to has as well, are run once."""
    with ExitStack() as stack:
        for command in (*about("forearm"), *about("my_arm")):
            print(command, flush=True)
            if command.robot == "forearm" and command.ours in ("learn", "up"):
                continue
            if command.ours == "up":
                stack.close()
                started = running(*command.words[2:], *SPEED, name=command.robot)
                _, watch = stack.enter_context(started)
            elif command.words[0] != "myograft":
                stack.close()
                shell(command, clone)
            elif command.ours in ("body", "new", "status"):
                assert main(list(command.words[1:])) == DONE
                if command.ours == "new":
                    hasten(Path(f"{command.robot}.toml"))
            elif command.ours == "learn":
                assert main([*command.words[1:], "--motions", "1", *SPEED]) == DONE
            else:
                carry_out(command, watch)
    assert living_hubs() == []


def test_a_real_chain_is_rehearsed(clone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (terminals,) = (x for x in about("elbow") if "hardware_sim.terminals" in x.words)
    make, up = about("elbow_serial")
    shell(make, clone)
    file = Path(up.words[2])
    slowly = {"rate_hz = 200.0": "rate_hz = 100.0", "watchdog_ms = 100": "watchdog_ms = 500"}
    for usual, slow in slowly.items():  # as the how-to has it for a busy machine
        file.write_text(file.read_text().replace(usual, slow))
    words = [word.replace("/tmp/", f"{clone}/") for word in terminals.words[1:]]
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True) as robot:
        try:
            assert robot.stdout is not None
            assert f"serial://{clone}/elbow/arm" in robot.stdout.readline()
            with running(*up.words[2:], name="elbow_serial") as (_, watch):
                rest(watch, "hold")
                states = watch.last(m.ChainBody).modules
                assert {module.state for module in states} == {"up"}
                assert "world" not in {row.process for row in watch.last(m.GroupState).processes}
                for words in ("plug biceps_3", "unplug biceps_1", "fault list", "fault mend"):
                    assert main(words.split()) == REFUSED
                    assert "is on real chains" in capsys.readouterr().err
            robot.send_signal(2)
            assert robot.wait(PATIENCE_S) == 0
        finally:
            robot.kill()


def test_a_robot_is_spread_over_hosts(
    clone: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two hosts' state folders, and a router between them as the how-to has it."""
    router = free_endpoint()
    config = zenoh.Config.from_file(ROOT / "deploy" / "zenoh" / "router.json5")
    config.insert_json5("listen/endpoints", f'["{router}"]')
    parts = [x for x in shown() if x.form == ONLY]
    assert len(parts) == 2
    with zenoh.open(config), ExitStack() as stack:
        for number, part in enumerate(parts):
            words = [re.sub(r"tcp/.*", router, word) for word in part.words[2:]]
            home = clone / f"host-{number}"
            stack.enter_context(running(*words, name="elbow", home=home))
        monkeypatch.setenv(ENDPOINT_VARIABLE, router)
        monkeypatch.setenv("XDG_STATE_HOME", str(clone / "host-2"))
        for command in about(ELSEWHERE):
            assert main(list(command.words[1:])) == DONE, str(command)
    said = capsys.readouterr().out
    assert "biceps_1" in said, "status of a robot of another host"
    assert "elbow/chain/arm/state: " in said, "and its rates"


def test_every_command_belongs_to_a_chapter() -> None:
    told = {x.robot for x in shown() if x.where == "robot"}
    assert told == {"elbow", "my_arm", "forearm", "elbow_serial", ELSEWHERE}
    modules = [x.words[2] for x in about("elbow") if not x.ours]
    assert modules == ["runtime.process", "hardware_sim.terminals"]
