"""`python -m experiments learn`: a robot's first body schema, made in the rig."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.collect import Array, Recording, collect_old
from experiments.imperfect import learn_drawn, refine_drawn
from experiments.progress import bars
from runtime.cli.main import UsageError
from runtime.settings import RobotSettings, load_robot
from services.body_schema import train
from services.body_schema.motions import SLACK_N, residuals_m
from services.body_schema.schema import Schema
from services.logic.wiring import Wiring, nominal_paths, served

HELD_OUT_EVERY = 10
LEAST_S = 20.0  # of motion: below, hardly anything is left to learn from
DURATION_S = 500.0
ASKED, TOUCHED_M = 40, 1e-6  # postures, and the moment arm of a wire that crosses a joint
REFINE_MOTIONS = 5  # as few as the experiments' least on a body of several joints
# For bodies of more than one joint: tried on musashi_arm, not searched.
LARGER_DURATION_S = 1500.0
LARGER_STEPS, LARGER_BATCH, LARGER_RATE = 60_000, 256, 2e-3


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `learn`."""
    parser.add_argument("robot", nargs="?", default="elbow", help="robot or robot file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--seconds",
        type=float,
        help=f"robot time of motion to learn from; default: {DURATION_S:g},"
        f" for more than one joint {LARGER_DURATION_S:g}",
    )
    parser.add_argument(
        "--drawing-off-mm",
        type=float,
        metavar="MM",
        help="learn from the body's file instead of motion, every site that far off",
    )
    parser.add_argument(
        "--refine-motions",
        type=int,
        default=REFINE_MOTIONS,
        metavar="N",
        help=f"of the robot, that refine what a drawing taught (default {REFINE_MOTIONS}; 0: none)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="default: the robot file's schema, and NAME_h_old.safetensors beside it, which is what"
        " experiments begin with; of a drawing, NAME_model.safetensors",
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of motion and training")


def run(args: argparse.Namespace) -> int:
    """Collect, train, print the residuals on held-out samples, write the schema."""
    settings = load_robot(args.robot)
    out = args.out or _usual_out(settings, args)
    if args.seconds is not None and args.seconds < LEAST_S:
        raise UsageError(f"--seconds {args.seconds:g}: give {LEAST_S:g} at least")
    if args.drawing_off_mm is not None and args.drawing_off_mm < 0.0:
        raise UsageError(f"--drawing-off-mm {args.drawing_off_mm:g}: give 0 or more")
    if args.refine_motions < 0:
        raise UsageError(f"--refine-motions {args.refine_motions}: give 0 or more")
    start = time.monotonic()
    if args.drawing_off_mm is not None:
        schema = _from_drawing(settings, args)
        return _write(schema, out, start)
    seconds = usual_s(settings) if args.seconds is None else args.seconds
    seconds /= 10 if args.quick else 1
    with bars() as narrate:
        recording = collect_old(
            settings, args.seed, seconds, lambda s: narrate("collect", round(100 * s), 100)
        )
        old = learn_old(
            recording,
            args.seed,
            quick=args.quick,
            progress=lambda epoch, epochs, *_: narrate("train", epoch, epochs),
        )
        narrate("solve", 0, 1)
        shipped = sharpen(settings, old, recording, args.seed)
        narrate("solve", 1, 1)
    for schema, file in ((old, of_paper(out)), (shipped, out)):
        length_mm, angle_rad = held_out(schema, recording)
        words = _by_muscle(schema, length_mm)
        print(f"held-out samples: length (mask 110) {words}; angle (mask 011) {angle_rad:.4f} rad")
        _write(schema, file, start)
    return 0


def _usual_out(settings: RobotSettings, args: argparse.Namespace) -> Path:
    file = settings.schema_file
    if file is None:
        raise UsageError(f"{settings.file}: [robot] names no schema; give --out FILE")
    return file if args.drawing_off_mm is None else of_drawing(file)


def of_drawing(schema_file: Path) -> Path:
    """Where the schema stands that a drawing taught, beside the robot's own."""
    return schema_file.with_name(f"{schema_file.stem}_model{schema_file.suffix}")


def of_paper(schema_file: Path) -> Path:
    """Where h_old stands, as the paper's network is trained; the robot's own is sharpened."""
    return schema_file.with_name(f"{schema_file.stem}_h_old{schema_file.suffix}")


def _from_drawing(settings: RobotSettings, args: argparse.Namespace) -> Schema:
    error_m, seed, quick = args.drawing_off_mm * 1e-3, args.seed, args.quick
    with bars() as narrate:

        def drawing(epoch: int, epochs: int, *_: float) -> None:
            narrate("train", epoch, epochs)

        def refining(epoch: int, epochs: int, *_: float) -> None:
            narrate("refine", epoch, epochs)

        drawn = learn_drawn(settings, error_m, seed, quick=quick, progress=drawing)
        if not args.refine_motions:
            return drawn
        schema, collected = refine_drawn(
            settings, drawn, args.refine_motions, seed, quick=quick, progress=refining
        )
    before, after, wires = (
        _by_muscle(schema, (residuals_m(model, collected.check) * 1e3).tolist())
        for model in (
            replace(drawn, wires=None),
            replace(schema, wires=None),
            served(schema, settings.body_file, settings.joints),
        )
    )
    print(f"held-out motion: length by the drawing {before}")
    print(f"  refined {after}")
    print(f"  wires {wires}")
    print(f"greatest tension while collecting: {collected.peak_tension_n:.0f} N")
    return schema


def _by_muscle(schema: Schema, length_mm: list[float]) -> str:
    return ", ".join(f"{n} {v:.2f} mm" for n, v in zip(schema.muscles, length_mm, strict=True))


def _write(schema: Schema, out: Path, start_s: float) -> int:
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(schema.to_bytes())
    print(f"{out.stat().st_size / 1000:.0f} kB in {out}, after {time.monotonic() - start_s:.0f} s")
    return 0


def usual_s(settings: RobotSettings) -> float:
    """Robot time of motion that a first schema is learned from."""
    return DURATION_S if len(settings.joints) == 1 else LARGER_DURATION_S


def learn_old(
    recording: Recording,
    seed: int,
    *,
    quick: bool = False,
    progress: Callable[[int, int, float, float, float], None] | None = None,
) -> Schema:
    """Train h_old on what was recorded, but for every tenth sample."""
    theta, f, length, held = taut(recording)
    return train.train_old(
        recording.joints,
        recording.muscles,
        theta[~held],
        f[~held],
        length[~held],
        seed=seed,
        recipe=recipe_for(len(recording.joints), quick=quick),
        progress=progress,
    )


def sharpen(settings: RobotSettings, old: Schema, recording: Recording, seed: int) -> Schema:
    """What the robot is shipped with: h_old with units of its own for each question."""
    theta, f, length, held = taut(recording)
    paths = nominal_paths(settings.body_file)
    wiring = Wiring(settings.body_file, old.joints, {name: paths[name] for name in old.muscles})
    some = theta[held][:: max(1, held.sum() // ASKED)]
    arms_m = np.abs([wiring.lengths_and_jacobian(posture)[1] for posture in some])
    crossed = arms_m.max(axis=0) > TOUCHED_M
    return train.sharpened(old, theta[~held], f[~held], length[~held], crossed, seed=seed)


def recipe_for(joints: int, *, quick: bool = False) -> train.Recipe:
    """How hard a first schema is trained."""
    recipe = train.OLD
    if joints > 1:  # more to tell apart: more steps, each over more samples
        recipe = replace(train.OLD, steps=LARGER_STEPS, batch=LARGER_BATCH, rate=LARGER_RATE)
    return replace(recipe, steps=recipe.steps // 10) if quick else recipe


def held_out(schema: Schema, recording: Recording) -> tuple[list[float], float]:
    """Rms residuals on the samples left out: lengths by muscle [mm], angles in all [rad]."""
    theta, f, length, held = taut(recording)
    length_m = schema.lengths(theta[held], f[held]) - length[held]
    angle_rad = schema.estimate(f[held], length[held]) - theta[held]
    rms_mm = np.sqrt(np.mean(length_m**2, axis=0)) * 1e3
    return rms_mm.tolist(), float(np.sqrt(np.mean(angle_rad**2)))


def taut(recording: Recording) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """The taut samples: theta (T, N), f (T, M), l (T, M), and which of them are held out."""
    taut = (recording.tension_n >= SLACK_N).all(axis=1)
    theta, f = recording.angle_rad[taut], recording.tension_n[taut]
    held = np.arange(len(theta)) % HELD_OUT_EVERY == 0
    return theta, f, recording.length_m[taut], held
