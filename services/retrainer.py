"""Process: training jobs in, body schema versions out."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

from runtime.process import Launch
from services.logic.retrainer import Retrainer


def main(launch: Launch) -> None:
    """Run the retrainer of one robot; one thread beside it learns."""
    settings, learner = launch.settings, ThreadPoolExecutor(1, "learner")
    file = settings.schema_file
    shipped = file.read_bytes() if file is not None and file.exists() else None
    retrainer = Retrainer(settings, launch.store, shipped, learner.submit, time.perf_counter)
    try:
        launch.run(retrainer)
    finally:
        retrainer.cancel()
        learner.shutdown(wait=True)
