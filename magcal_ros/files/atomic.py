"""Writing a file so that a kill at any moment leaves the old one or the new one."""

from __future__ import annotations

import contextlib
import glob
import os
import tempfile
import time
from pathlib import Path

from magcal_ros.core.errors import MagcalError


class FileTrouble(MagcalError):
    """A file cannot be read or written; the text says which, why, and what to do."""


UNFINISHED = ".magcal-unfinished"
"""How the names of files end that are being written; a kill may leave one behind."""

LEFT_BEHIND = 3600.0
"""Seconds after which nobody is writing it any more."""

REMEDY = "Choose a writable place with the parameter calibration_file, or mend its permissions."


def write_atomically(path: Path, text: str, remedy: str = REMEDY) -> None:
    """Replace the content of a file in one step.

    Parameters
    ----------
    path : Path
        The file; its folder is made if it is missing.
    text : str
        The whole new content.
    remedy : str
        What the user should do when it fails.

    Raises
    ------
    FileTrouble
        If the folder cannot be made or written to, or the disk is full; the old file stays.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path)
        descriptor, name = tempfile.mkstemp(UNFINISHED, f".{path.name}.", path.parent)
    except OSError as error:
        raise _trouble(path, error, remedy) from error
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as handle:
            handle.write(text)
            handle.flush()
            os.fsync(handle.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(name)
        if isinstance(error, OSError):
            raise _trouble(path, error, remedy) from error
        raise
    _sync_folder(path.parent)


def _sweep(path: Path) -> None:
    """Remove what writers of this file left behind when they were killed."""
    too_old = time.time() - LEFT_BEHIND
    for left in path.parent.glob(f".{glob.escape(path.name)}.*{UNFINISHED}"):
        with contextlib.suppress(OSError):
            if left.stat().st_mtime < too_old:
                left.unlink()


def _sync_folder(folder: Path) -> None:
    """Make the renaming itself durable, where the file system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _trouble(path: Path, error: OSError, remedy: str) -> FileTrouble:
    return FileTrouble(f"cannot write {path}: {error.strerror or error}. {remedy}")
