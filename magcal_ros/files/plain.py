"""Names that came from outside, made fit to be shown."""

from __future__ import annotations

LONGEST = 200


def plain(text: str) -> str:
    """Return `text` in which nothing can steer a terminal.

    Topics and frames of a bag are whatever its writer liked. Every character that is not
    printable (control characters, escapes, direction marks, line breaks) becomes "?", and a very
    long text is cut.
    """
    shown = "".join(letter if letter.isprintable() else "?" for letter in text[:LONGEST])
    return shown if len(text) <= LONGEST else shown + "…"
