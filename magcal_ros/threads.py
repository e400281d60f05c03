"""How many threads linear algebra may use."""

from __future__ import annotations

import os

POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def use_one() -> None:
    """Let numpy compute in one thread, unless the user has said otherwise.

    The matrices here are small: threads would hold each other up, and take the cores from others.
    It holds for a numpy that is loaded later, and for processes started from this one.
    """
    for pool in POOLS:
        os.environ.setdefault(pool, "1")
