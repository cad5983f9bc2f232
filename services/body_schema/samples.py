"""What a network is trained on: scaled samples, each behind the three masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.body_schema.network import MASKS, Array
from services.body_schema.schema import Schema
from services.body_schema.train_network import Single, single


@dataclass(frozen=True, eq=False)
class Samples:
    """Scaled samples and their three masked inputs."""

    inputs: Single  # (T, 3, N + 2 M + 3)
    targets: Single  # (T, 1, N + 2 M)
    keep: Single  # (T, 1, N + 2 M): r, 0 where the target is not known

    def __len__(self) -> int:
        return len(self.targets)

    def __add__(self, other: Samples) -> Samples:
        """These samples and behind them the others."""
        return Samples(
            np.concatenate((self.inputs, other.inputs)),
            np.concatenate((self.targets, other.targets)),
            np.concatenate((self.keep, other.keep)),
        )


def masked(schema: Schema, theta: Array, f: Array, length: Array) -> Samples:
    """All of theta (T, N) [rad], f (T, M) [N] and length (T, M) [m] asked for behind each mask."""
    targets = schema.scaled(theta, f, length)
    widths = (len(schema.joints), len(schema.muscles), len(schema.muscles))
    inputs = [
        np.hstack((targets * np.repeat(mask, widths), np.tile(mask, (len(f), 1)))) for mask in MASKS
    ]
    known = single(targets[:, None])
    return Samples(single(np.stack(inputs, axis=1)), known, np.ones_like(known))


def with_zeros(data: Samples, n: int, m: int) -> Samples:
    """The same samples for a body of one muscle more, which reads zero and is not scored."""
    at = [n + m, n + 2 * m]

    def insert(a: Single) -> Single:
        return np.insert(a, at, 0.0, axis=-1)

    return Samples(insert(data.inputs), insert(data.targets), insert(data.keep))
