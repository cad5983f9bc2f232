"""Training of the body schema: the only file that imports torch.

    train_old  h_old from data
    relearn    h_new from h_old and a handful of motions, the paper's loss and its schedules
    distil     h for fewer muscles from h's own replay
    refit      a known muscle that came back: its length offset, in closed form

Where the paper is silent, our reading: the norms are unsquared L2 norms of scaled quantities, one
per sample and quantity, mean over the batch, summed over the quantities; all three masks in each
epoch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from runtime.messages import Motion
from services.body_schema.network import Array
from services.body_schema.schema import Schema

Progress = Callable[[int, int, float, float, float], None]  # epoch, epochs, loss, new, old


class TrainingError(ValueError):
    """Data that nothing can be learned from; the text says in one sentence why."""


def train_old(
    joints: tuple[str, ...],
    muscles: tuple[str, ...],
    theta: Array,
    f: Array,
    length: Array,
    *,
    seed: int = 0,
    epochs: int = 0,
    progress: Progress | None = None,
) -> Schema:
    """h_old from theta (T, N) [rad], f (T, M) [N], length (T, M) [m]. Reproducible by seed."""
    raise NotImplementedError


def relearn(
    old: Schema,
    motions: Sequence[Motion],
    added: str,
    method: str = "iii",
    *,
    seed: int = 0,
    epochs: int = 0,
    copy: bool = True,
    progress: Progress | None = None,
) -> Schema:
    """h_new, with `added` as its last muscle, from h_old and motions: L = L_new + w L_old.

    The motions' columns are old.joints and (*old.muscles, added). Methods: i (w = 0), ii (w = 1),
    iii (w = 1 - e / N_epoch). `copy=False` starts from random weights, as the paper's control.

    Raises:
        TrainingError: nothing to learn from.
    """
    raise NotImplementedError


def distil(
    old: Schema, keep: tuple[str, ...], *, seed: int = 0, progress: Progress | None = None
) -> Schema:
    """The schema of the muscles in `keep` alone, from h_old's own mask-110 replay."""
    raise NotImplementedError


def refit(
    schema: Schema, motions: Sequence[Motion], returning: Sequence[str], limit_mm: float
) -> Schema:
    """The schema with the length offsets of muscles that came back estimated anew.

    The motions' columns are schema.joints and schema.muscles.

    Raises:
        TrainingError: a residual stays above `limit_mm`: the muscle is not where it was.
    """
    raise NotImplementedError
