"""Makes names from outside safe to print."""

from __future__ import annotations

LONGEST = 200


def plain(text: str, longest: int = LONGEST) -> str:
    """Return `text` in which nothing can steer a terminal.

    Topics and frames of a bag, and what comes from the network, are whatever their writer liked.
    Every character that is not printable (control characters, escapes, direction marks, line
    breaks) becomes "?", and a very long text is cut.
    """
    shown = "".join(letter if letter.isprintable() else "?" for letter in text[:longest])
    return shown if len(text) <= longest else shown + "…"


def plain_lines(text: str) -> str:
    """Return all lines of a text, each as `plain` has it and none cut."""
    return "\n".join(plain(line, len(line)) for line in text.split("\n"))
