"""Atomic writing, safe reading, and a time limit for a disk that does not answer."""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, TypeVar

from magcal_ros.core.errors import MagcalError


class FileError(MagcalError):
    """A file cannot be read or written; the text names the file, the reason and a remedy."""

    @classmethod
    def of(cls, path: Path, words: str) -> FileError:
        """Return an error whose text begins with the path, in printable characters."""
        return cls(f"{printable(str(path))} {words}")


UNFINISHED = ".magcal-unfinished"
"""Suffix of files that are being written; a killed process may leave one behind."""

LEFT_BEHIND = 3600.0  # seconds after which an unfinished file counts as abandoned

REMEDY = "Choose a writable place with the parameter calibration_file, or correct its permissions."


def write_atomically(
    path: Path, text: str, remedy: str = REMEDY, when_written: Callable[[], object] | None = None
) -> None:
    """Replace the content of a file in one step; after a FileError the file is unchanged.

    If the path is a symbolic link, its target is replaced. Mode and, if allowed, owner of an old
    file are kept; a new file has the mode by the umask. A missing folder is made. `remedy` is the
    advice to the user on failure. `when_written` is called after the new content is on the disk,
    immediately before it replaces the old content.
    """
    try:
        _replace(Path(os.path.realpath(path)), text, when_written)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}. {remedy}") from error


def _replace(target: Path, text: str, when_written: Callable[[], object] | None) -> None:
    before = _status_of(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    _remove_abandoned(target)
    name = target.with_name(f".{target.name}.{os.urandom(4).hex()}{UNFINISHED}")
    mode = 0o666 if before is None else stat.S_IRUSR | stat.S_IWUSR
    descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as handle:
            handle.write(text)
            handle.flush()
            if before is not None:
                _keep_owner_and_mode(before, descriptor)
            os.fsync(descriptor)
        if when_written is not None:
            when_written()
        os.replace(name, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise
    _sync_folder(target.parent)


def _status_of(target: Path) -> os.stat_result | None:
    """Return the status of the old file; None if there is no file."""
    try:
        about = os.stat(target)
    except (FileNotFoundError, NotADirectoryError):
        return None
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(about.st_mode):
        raise FileExistsError(errno.EEXIST, "it is a device or a pipe, not a file")
    return about


def _keep_owner_and_mode(before: os.stat_result, descriptor: int) -> None:
    """Give the new file owner, group and mode of the old file, as far as allowed."""
    mode = stat.S_IMODE(before.st_mode)
    try:
        os.fchown(descriptor, before.st_uid, before.st_gid)
    except OSError:
        try:
            os.fchown(descriptor, -1, before.st_gid)
        except OSError:
            # The new file has another group, which must not get the old group's rights.
            mode &= ~stat.S_IRWXG
    os.fchmod(descriptor, mode)


def _remove_abandoned(path: Path) -> None:
    """Remove abandoned unfinished files of this path."""
    too_old = time.time() - LEFT_BEHIND
    for left in path.parent.glob(f".{glob.escape(path.name)}.*{UNFINISHED}"):
        with contextlib.suppress(OSError):
            if left.stat().st_mtime < too_old:
                left.unlink()


def _sync_folder(folder: Path) -> None:
    """Make the renaming durable, if the file system supports this."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


LONGEST = 200


def printable(text: str, longest: int = LONGEST) -> str:
    """Return `text` without characters that could control a terminal, and cut to a length.

    Topics and frames of a bag, and texts from the network, may contain any character. Each one that
    is not printable (control characters, direction marks, line breaks) becomes "?".
    """
    shown = "".join(letter if letter.isprintable() else "?" for letter in text[:longest])
    return shown if len(text) <= longest else shown + "…"


def printable_lines(text: str) -> str:
    """Return a text with `printable` applied to each line, but none cut."""
    return "\n".join(printable(line, len(line)) for line in text.split("\n"))


PATIENCE = 5.0  # seconds within which any working disk answers

Result = TypeVar("Result")


class NotRegularFile(ValueError):
    """A path is not a regular file, or the file is too large; the text says which."""


def read_small(path: Path, largest: int) -> bytes:
    """Return the content of a regular file; NotRegularFile for anything else or a larger one."""
    with open_regular(path) as handle:
        about = os.fstat(handle.fileno())
        # The size of a file that is generated when read (/proc) may be wrong: check both.
        content = b"" if about.st_size > largest else handle.read(largest + 1)
    if about.st_size > largest or len(content) > largest:
        raise NotRegularFile(f"it is too large: more than {largest} bytes")
    return content


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; NotRegularFile for a pipe, a device or a socket."""
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise NotRegularFile("it is not a regular file")


@contextlib.contextmanager
def damage_in_words(path: Path, damage: str, remedy: str) -> Iterator[None]:
    """Raise any error of a library that reads damaged bytes as a FileError."""
    try:
        yield
    except MagcalError:
        raise
    except OSError as error:
        raise FileError(f"cannot read {printable(str(path))}: {error.strerror or error}") from error
    except Exception as error:  # a damaged file may cause any error in a parser
        reason = printable(" ".join(str(error).split()) or type(error).__name__)
        raise FileError.of(path, f"is damaged or {damage} ({reason}). {remedy}") from error


def with_time_limit(work: Callable[[], Result], path: Path, patience: float = PATIENCE) -> Result:
    """Call `work`, which uses a disk; FileError if it takes longer than `patience`, seconds.

    A network mount without its server blocks a thread for hours, and no signal ends this. So the
    work is done in a thread that may be left behind. `path` is for the message.
    """
    done: list[Result] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            done.append(work())
        except BaseException as error:  # raised again in the caller's thread
            failed.append(error)

    thread = threading.Thread(target=run, name="disk", daemon=True)
    thread.start()
    thread.join(patience)
    if failed:
        raise failed[0]
    if not done:
        raise FileError(
            f"{path} does not answer within {patience:g} s: check its disk or network share, or "
            "name another place with the parameter calibration_file"
        )
    return done[0]
