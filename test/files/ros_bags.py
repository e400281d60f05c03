"""The used part of `rosbag2_py`, according to its published source, by the library rosbags.

Names, arguments, results and errors follow rosbag2_py/src/rosbag2_py/_reader.cpp, _info.cpp and
_storage.cpp. `before_jazzy` gives what Humble and Iron have: a storage that must be named, and a
duration as a timedelta.
"""

import datetime
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType, SimpleNamespace

from rosbags.rosbag2 import Reader, ReaderError


def kind_of(folder):
    return "mcap" if list(folder.glob("*.mcap")) else "sqlite3"


def rosbag2_py(before_jazzy=False):
    module = ModuleType("rosbag2_py")

    def open_bag(uri):
        try:
            reader = Reader(Path(uri))
            stack = ExitStack()
            stack.enter_context(reader)
        except (ReaderError, OSError) as error:
            raise RuntimeError(
                f"No storage could be initialized from the inputs: {error}"
            ) from None
        return reader, stack

    class StorageOptions:
        def __init__(self, uri, storage_id=None if before_jazzy else ""):
            if storage_id is None:
                raise TypeError("__init__(): incompatible constructor arguments.")
            self.uri, self.storage_id = uri, storage_id

    class ConverterOptions:
        def __init__(self, input_serialization_format="", output_serialization_format=""):
            self.input_serialization_format = input_serialization_format
            self.output_serialization_format = output_serialization_format

    class StorageFilter:
        def __init__(self, topics=()):
            self.topics = list(topics)

    class SequentialReader:
        def open(self, storage_options, converter_options):
            if before_jazzy and not storage_options.storage_id:
                raise RuntimeError("No storage id specified.")
            assert converter_options.output_serialization_format == "cdr"
            self._reader, self._stack = open_bag(storage_options.uri)
            self.set_filter(StorageFilter())

        def set_filter(self, storage_filter):
            topics = storage_filter.topics
            chosen = [c for c in self._reader.connections if not topics or c.topic in topics]
            self._rest = self._reader.messages(chosen) if chosen else iter(())
            self._next = next(self._rest, None)

        def has_next(self):
            return self._next is not None

        def read_next(self):
            connection, stamp, data = self._next
            self._next = next(self._rest, None)
            return connection.topic, bytes(data), stamp

    class SequentialCompressionReader(SequentialReader):
        pass

    class Info:
        def read_metadata(self, uri, storage_id):
            reader, stack = open_bag(uri)
            with stack:
                topics = [
                    SimpleNamespace(
                        topic_metadata=SimpleNamespace(name=c.topic, type=c.msgtype),
                        message_count=c.msgcount,
                    )
                    for c in reader.connections
                ]
                length = reader.duration - 1 if reader.message_count else 0
                return SimpleNamespace(
                    message_count=reader.message_count,
                    topics_with_message_count=topics,
                    storage_identifier=storage_id or kind_of(Path(uri)),
                    compression_format=reader.compression_format or "",
                    compression_mode=reader.compression_mode or "",
                    duration=datetime.timedelta(microseconds=length / 1000.0)
                    if before_jazzy
                    else SimpleNamespace(nanoseconds=length),
                )

    for kind in (
        StorageOptions, ConverterOptions, StorageFilter, SequentialReader,
        SequentialCompressionReader, Info,
    ):  # fmt: skip
        setattr(module, kind.__name__, kind)
    return module
