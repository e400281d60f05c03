"""Writing a file so that a kill at any moment leaves the old one or the new one."""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import secrets
import stat
import time
from collections.abc import Callable
from pathlib import Path

from magcal_ros.core.errors import MagcalError


class FileTrouble(MagcalError):
    """A file cannot be read or written; the text says which, why, and what to do."""


UNFINISHED = ".magcal-unfinished"
"""How the names of files end that are being written; a kill may leave one behind."""

LEFT_BEHIND = 3600.0
"""Seconds after which nobody is writing it any more."""

REMEDY = "Choose a writable place with the parameter calibration_file, or correct its permissions."


def write_atomically(
    path: Path, text: str, remedy: str = REMEDY, when_written: Callable[[], object] | None = None
) -> None:
    """Replace the content of a file in one step.

    A symbolic link stays one: what it points to is replaced. A file that was there passes on its
    mode, and its owner as far as that is allowed; a new one has what the umask leaves.

    Parameters
    ----------
    path : Path
        The file; its folder is made if it is missing.
    text : str
        The whole new content.
    remedy : str
        What the user should do when it fails.
    when_written : callable, optional
        Called when the new content is safely on the disk, right before it takes the old one's
        place.

    Raises
    ------
    FileTrouble
        If the folder cannot be made or written to, or the disk is full; the old file stays.
        Also if there is something else than a file.
    """
    try:
        target = Path(os.path.realpath(path))
        before = _looked_at(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target)
        name = target.with_name(f".{target.name}.{secrets.token_hex(4)}{UNFINISHED}")
        mode = 0o666 if before is None else stat.S_IRUSR | stat.S_IWUSR
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    except OSError as error:
        raise _trouble(path, error, remedy) from error
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as handle:
            handle.write(text)
            handle.flush()
            if before is not None:
                _pass_on(before, descriptor)
            os.fsync(descriptor)
        if when_written is not None:
            when_written()
        os.replace(name, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(name)
        if isinstance(error, OSError):
            raise _trouble(path, error, remedy) from error
        raise
    _sync_folder(target.parent)


def _looked_at(target: Path) -> os.stat_result | None:
    """Return what is known about the old file; None if there is none."""
    try:
        about = os.stat(target)
    except (FileNotFoundError, NotADirectoryError):
        return None
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(about.st_mode):
        raise FileExistsError(errno.EEXIST, "it is a device or a pipe, not a file")
    return about


def _pass_on(before: os.stat_result, descriptor: int) -> None:
    """Give the new file the old one's owner, group and mode."""
    mode = stat.S_IMODE(before.st_mode)
    try:
        os.fchown(descriptor, before.st_uid, before.st_gid)
    except OSError:
        try:
            os.fchown(descriptor, -1, before.st_gid)
        except OSError:
            # What the old group was allowed, the new one is not.
            mode &= ~stat.S_IRWXG
    os.fchmod(descriptor, mode)


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
