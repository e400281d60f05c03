"""Bags read with ROS's own `rosbag2_py`, so that a robot needs no other library.

It offers what `bags` needs of a reader, with the names that the library rosbags gives it. Held
against the published source of rosbag2_py from Humble to Rolling: before Jazzy the metadata's
duration is a `timedelta`, since then an `rclpy` Duration; Humble wants the storage named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from magcal_ros.files.atomic import FileTrouble

STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}


class Channel(NamedTuple):
    """A topic of the bag."""

    id: str
    topic: str
    msgtype: str
    msgcount: int


class RosReader:
    """An open rosbag2.

    Parameters
    ----------
    path : Path
        Folder with metadata.yaml, or a single .mcap or .db3.
    library : module
        `rosbag2_py`.

    Raises
    ------
    RuntimeError
        Where the library cannot read it.
    """

    is2 = True

    def __init__(self, path: Path, library: Any) -> None:
        self._path, self._library = path, library
        self._metadata = library.Info().read_metadata(str(path), _storage_of(path))
        self.message_count = int(self._metadata.message_count)
        self.connections = [
            Channel(about.name, about.name, about.type, int(topic.message_count))
            for topic in self._metadata.topics_with_message_count
            for about in (topic.topic_metadata,)
        ]
        # The metadata's own start is rounded to microseconds before Jazzy.
        first = next(self._everything(self.connections), None)
        self.start_time = 0 if first is None else first[2]
        self.end_time = self.start_time + _nanoseconds(self._metadata.duration) + 1

    def messages(
        self, connections: Iterable[Channel], start: int, stop: int
    ) -> Iterator[tuple[Channel, int, bytes]]:
        """Yield channel, time of recording in ns and bytes from `start` to before `stop`."""
        channels = {channel.topic: channel for channel in connections}
        for topic, data, stamp in self._everything(channels.values()):
            if stamp >= stop:
                # Messages are written as they come: a later one may be a little older.
                if stamp >= stop + LATE:
                    return
            elif stamp >= start and topic in channels:
                yield channels[topic], stamp, data

    def deserialize(self, _: bytes, msgtype: str) -> NoReturn:
        """Take apart what is not in the usual byte order, which this reader cannot.

        Raises
        ------
        FileTrouble
            Always.
        """
        raise FileTrouble(
            f"{self._path} has {msgtype} messages in big-endian byte order: read it where the "
            "Python library rosbags is installed and ROS is not"
        )

    def _everything(self, channels: Iterable[Channel]) -> Iterator[tuple[str, bytes, int]]:
        library = self._library
        storage = self._metadata.storage_identifier or _storage_of(self._path)
        is_packed = bool(self._metadata.compression_mode or self._metadata.compression_format)
        kind = library.SequentialCompressionReader if is_packed else library.SequentialReader
        reader = kind()
        reader.open(
            library.StorageOptions(uri=str(self._path), storage_id=storage),
            library.ConverterOptions("cdr", "cdr"),
        )
        reader.set_filter(library.StorageFilter(topics=[channel.topic for channel in channels]))
        while reader.has_next():
            yield reader.read_next()


LATE = 5_000_000_000
"""Nanoseconds after the end of a span within which a message of the span may still come."""


def _storage_of(path: Path) -> str:
    """Return the storage by the file's name; a folder's metadata names it."""
    return STORAGES.get(path.suffix, "") if path.is_file() else ""


def _nanoseconds(duration: Any) -> int:
    if isinstance(duration, timedelta):
        return round(duration.total_seconds() * 1e9)
    return int(duration.nanoseconds)
