"""Writing a file so that a kill at any moment leaves the old one or the new one."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from magcal_ros.core.errors import MagcalError


class FileTrouble(MagcalError):
    """A file cannot be read or written; the text says which, why, and what to do."""


def write_atomically(path: Path, text: str) -> None:
    """Replace the content of a file in one step.

    Parameters
    ----------
    path : Path
        The file; its folder is made if it is missing.
    text : str
        The whole new content.

    Raises
    ------
    FileTrouble
        If the folder cannot be made or written to, or the disk is full; the old file stays.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise _trouble(path, error) from error
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
            raise _trouble(path, error) from error
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


def _trouble(path: Path, error: OSError) -> FileTrouble:
    return FileTrouble(
        f"cannot write {path}: {error.strerror or error}. "
        "Choose a writable place (parameter calibration_file, option --output), or mend its "
        "permissions."
    )
