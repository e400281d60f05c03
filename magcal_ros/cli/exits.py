"""Exit statuses of `magcal`, the same for every command."""

from __future__ import annotations

from enum import IntEnum


class Exit(IntEnum):
    """What the shell sees."""

    GOOD = 0
    FAILED = 1
    USAGE = 2
    TOO_LITTLE_DATA = 3
    REFUSED = 4
    FILE_TROUBLE = 5
    INTERRUPTED = 130
