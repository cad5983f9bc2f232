"""Commands in processes of their own, for tests that read what they print."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def started(*words: str) -> Iterator[subprocess.Popen[str]]:
    """`python WORDS`; killed if the test is not content, so that nobody waits for its end."""
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()
