"""Reading a small file that may be anything: a pipe, a device, a folder, a gigabyte."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, TypeVar

from magcal_ros.core.errors import MagcalError
from magcal_ros.files.atomic import FileTrouble

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


PATIENCE = 5.0
"""Seconds within which a disk answers that is there at all."""

Result = TypeVar("Result")


class NotOrdinary(ValueError):
    """What lies there is no regular file, or larger than allowed; the text says which."""


def read_small(path: Path, largest: int) -> bytes:
    """Return the content of a regular file; nothing else is waited for.

    Raises
    ------
    NotOrdinary
        If it is a pipe, a device, a socket, or too large.
    OSError
        If it cannot be read.
    """
    with open_regular(path) as handle:
        about = os.fstat(handle.fileno())
        # The size may be wrong where a file is made as it is read (/proc), so both are looked at.
        content = b"" if about.st_size > largest else handle.read(largest + 1)
    if about.st_size > largest or len(content) > largest:
        raise NotOrdinary(f"it is too large: more than {largest} bytes")
    return content


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; nothing else is waited for.

    Raises
    ------
    NotOrdinary
        If it is a pipe, a device or a socket.
    OSError
        If it cannot be read.
    """
    # Without O_NONBLOCK, opening a pipe waits for somebody who writes into it.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise NotOrdinary("it is not a regular file")


@contextlib.contextmanager
def damage_in_words(path: Path, damage: str, remedy: Callable[[], str]) -> Iterator[None]:
    """Turn whatever a library does with damaged bytes into FileTrouble."""
    try:
        yield
    except MagcalError:
        raise
    except OSError as error:
        raise FileTrouble(f"cannot read {plain(str(path))}: {error.strerror or error}") from error
    except Exception as error:  # a damaged file may end in any error of any parser below
        reason = plain(" ".join(str(error).split()) or type(error).__name__)
        raise FileTrouble(
            f"{plain(str(path))} is damaged or {damage} ({reason}). {remedy()}"
        ) from error


def promptly(work: Callable[[], Result], path: Path, patience: float = PATIENCE) -> Result:
    """Do what touches a disk, and give up waiting for a disk that does not answer.

    A mount whose server is gone holds whoever touches it, for hours and beyond every signal: the
    thread that does so stays behind.

    Parameters
    ----------
    work : callable
        What to do.
    path : Path
        For words.
    patience : float
        Seconds.

    Raises
    ------
    FileTrouble
        If it takes longer.
    """
    done: list[Result] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            done.append(work())
        except BaseException as error:  # handed on to the caller's thread, whatever it is
            failed.append(error)

    thread = threading.Thread(target=run, name="disk", daemon=True)
    thread.start()
    thread.join(patience)
    if failed:
        raise failed[0]
    if not done:
        raise FileTrouble(
            f"{path} does not answer within {patience:g} s: is it on a disk or a network share "
            "that is gone? Name another place with the parameter calibration_file"
        )
    return done[0]
