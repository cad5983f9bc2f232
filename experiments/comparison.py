"""One robot, one variant, one number of motions: every method learns, and is tried on a task.

What `elbow`, `arm` and `lift` have in common; each brings its robot, its score and its methods.
"""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time

import msgspec

from experiments.methods import PAPERS_OWN, relearned, settled, wired
from experiments.oracle import know_all
from experiments.paper_control import Descent, PaperArm
from experiments.rig import Rig
from experiments.session import SessionError
from experiments.statistics import BASELINES, PAPERS, Run
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.trial import Collected, collect, start
from experiments.variants import Variant
from runtime.settings import RobotSettings, load_robot
from services.body_schema.fit_wires import USUAL
from services.body_schema.model import BodyModel
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe
from services.logic.arm import Arm

CONVERGED = "converged"
CONTROLS = {
    PAPERS: "the paper's: settled samples, 300 steps of Adam on the latent space",
    CONVERGED: "whole trajectories, least tension, converged",
}
SHARINGS = {"norm": "least ||f||^2", "peak": "least peak tension"}  # by converged control
LEARNING = (
    Measure("learn", "relearning, processor time", "s", 1),
    Measure("learn_wall", "relearning, wall time", "s", 1),
)
Score = Callable[[Rig], dict[str, float]]  # runs the task; raises SessionError if it does not end
Curves = dict[str, list[float]]
Watch = Callable[[Rig], Callable[[], Curves]]  # from now on; what is returned tells what was seen


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Attributes:
        robot: its name.
        variants: by name.
        score: runs the task on a rig that holds, and gives its figures.
        watch: keeps curves of the task.
    """

    robot: str
    variants: Mapping[str, Variant]
    score: Score
    watch: Watch | None = None

    def fingerprint(self) -> dict[str, object]:
        """What decides about the results."""
        from services.body_schema import train

        settings = load_robot(self.robot)
        robot = msgspec.to_builtins(msgspec.structs.replace(settings, file=""))
        del robot["web"]  # where its page is served changes no figure
        return {
            "robot": robot,
            "body_crc": zlib.crc32(settings.body_file.read_bytes()),
            "variants": {name: variant.told(settings) for name, variant in self.variants.items()},
            "teach": asdict(train.TEACH),
            "beliefs": asdict(USUAL),
            "descent": asdict(Descent()),
        }

    def unit(
        self, unit: Unit, methods: tuple[str, ...], controls: tuple[str, ...], recipe: Recipe
    ) -> list[Run]:
        """All runs of one unit; N_new 0 are the baselines.

        `recipe` is that of the paper's methods. `controls` are of `CONTROLS`, or of `SHARINGS`;
        the paper's is for what the paper has.
        """
        variant = self.variants[unit.variant]
        settings = variant.settings(load_robot(self.robot))
        old = variant.old(settings)
        network = replace(old, wires=None)
        trials = Trials(self.score, unit, settings, variant, network, self.watch)
        collected = collect(settings, unit.seed, network, unit.n_new or 1, variant.arm(Arm))
        trials.known["collect_peak_n"] = collected.peak_tension_n
        converged = [control for control in controls if control != PAPERS]
        if unit.n_new == 0:
            for control in controls:
                trials.run("before", control, network, None)
            for control in converged:
                trials.run("oracle", control, None, collected)
            return trials.runs
        for method in methods:
            if method not in PAPERS_OWN:
                continue
            schemas: dict[bool, Schema] = {}
            for control in controls:
                papers = control == PAPERS
                if papers not in schemas:
                    motions = settled(collected.new) if papers else collected.new
                    with trials.learning():
                        schemas[papers] = relearned(
                            method, network, motions, settings, unit.seed, recipe
                        )
                trials.run(method, control, schemas[papers], collected)
        if {"(iv)", "(iv) network"} & {*methods}:
            with trials.learning():
                models = wired(old, collected.new, settings, unit.seed)
            for method, model in models.items():
                for control in converged if method in methods else ():
                    trials.run(method, control, model, collected)
        return trials.runs


class Trials:
    """Tries models on one robot, and keeps what came out.

    Attributes:
        runs: what came out so far.
        known: figures of the runs to come that are known before.
        learn_s: how long the model of the runs to come was learned, by processor and by wall.
    """

    def __init__(
        self,
        score: Score,
        unit: Unit,
        settings: RobotSettings,
        variant: Variant,
        old: Schema,
        watch: Watch | None = None,
    ) -> None:
        self.runs: list[Run] = []
        self.known: dict[str, float] = {}
        self.learn_s: dict[str, float] = {}
        self._score = score
        self._unit = unit
        self._settings = settings
        self._variant = variant
        self._old = old
        self._watch = watch

    @contextlib.contextmanager
    def learning(self) -> Iterator[None]:
        """Time what is learned in it."""
        begin_s, begin_wall_s = process_time(), perf_counter()
        yield
        self.learn_s = {
            "learn": process_time() - begin_s,
            "learn_wall": perf_counter() - begin_wall_s,
        }

    def run(
        self, method: str, control: str, model: BodyModel | None, robot: Collected | None
    ) -> None:
        """Do the task and score it. Without a model the oracle controls."""
        believed = self._variant.arm(PaperArm if control == PAPERS else Arm)
        arm = Arm if model is None else believed
        figures, curves = dict(self.known), None
        try:
            settings = self._settings
            if control in SHARINGS:
                sharing = msgspec.structs.replace(settings.control, sharing=control)
                settings = msgspec.structs.replace(settings, control=sharing)
            rig = start(settings, self._unit.seed, model or self._old, robot, arm)
            if model is None:
                know_all(rig)
                rig.run(1.0)
            curves = self._watch(rig) if self._watch else None
            figures |= self._score(rig)
        except SessionError:
            figures["failed"] = 1.0  # the robot stopped, or never came to rest
        run = Run(
            method=method,
            control=control,
            n_new=self._unit.n_new,
            seed=self._unit.seed,
            variant=self._unit.variant,
            figures=figures,
            wall_s=dict(self.learn_s) if method not in BASELINES else {},
        )
        if curves is not None:
            run["curves"] = curves()
        self.runs.append(run)
