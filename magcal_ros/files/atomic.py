"""Writing a file so that a kill at any moment leaves the old one or the new one."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from magcal_ros.core.errors import MagcalError


class FileTrouble(MagcalError):
    """A file cannot be read or written; the text says which, why, and what to do."""


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
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
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
