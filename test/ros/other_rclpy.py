"""The installed rclpy with internal parts renamed, or removed while it spins."""

import re
import sys
from importlib.machinery import PathFinder, SourceFileLoader

# The calls of rclpy's inside that the sensors' loop makes: owner, name.
CALLS = (
    ("WaitSet", "clear_entities"),
    ("WaitSet", "add_subscription"),
    ("WaitSet", "add_guard_condition"),
    ("WaitSet", "wait"),
    ("Subscription", "take_message"),
)


def rename(names, record):
    """Rename parts of rclpy's executors wherever rclpy says them, before rclpy is imported.

    A callback group's public method of the same name stays. A line is added to the file `record`
    for each place.
    """
    stated = re.compile(rf"(?<!group\.)\b({'|'.join(names)})\b")

    class Renaming(SourceFileLoader):
        def path_stats(self, path):
            raise OSError("neither read nor leave compiled code")

        def source_to_code(self, data, path, **options):
            text, places = stated.subn(r"\1_renamed", data.decode())
            with open(record, "a") as file:
                file.write(f"{path}\n" * places)
            return super().source_to_code(text.encode(), path, **options)

    class Finder(PathFinder):
        @classmethod
        def find_spec(cls, module, path=None, target=None):
            spec = None
            if module.startswith("rclpy.") and module != "rclpy.callback_groups":
                spec = PathFinder.find_spec(module, path, target)
            if spec is None or not isinstance(spec.loader, SourceFileLoader):
                return None
            spec.loader = Renaming(spec.loader.name, spec.loader.path)
            return spec

    sys.meta_path.insert(0, Finder)


class Vanishing:
    """A method that the loop of the sensors finds only a number of times; others always do."""

    def __init__(self, method, name, uses):
        self.method, self.name, self.uses = method, name, uses

    def __get__(self, instance, owner=None):
        if sys._getframe(1).f_code.co_filename.endswith("threads.py"):
            self.uses -= 1
            if self.uses < 0:
                raise AttributeError(f"{owner.__name__!r} object has no attribute {self.name!r}")
        return self.method.__get__(instance, owner)


def vanish(owner, name, uses):
    """Remove an internal method of rclpy for the loop; returns a function that restores it."""
    from rclpy.impl.implementation_singleton import rclpy_implementation

    kind = getattr(rclpy_implementation, owner)
    method = vars(kind)[name]
    setattr(kind, name, Vanishing(method, name, uses))
    return lambda: setattr(kind, name, method)
