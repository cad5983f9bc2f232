"""Process: muscle states in, joint estimate out."""

from __future__ import annotations

from runtime.process import Launch
from services.logic.estimator import Estimator


def main(launch: Launch) -> None:
    """Run the estimator of one robot."""
    launch.run(Estimator(launch.settings), traced=True)
