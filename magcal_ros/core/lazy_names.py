"""The public names of a room, which are loaded when they are used.

A node therefore starts without the libraries that only other parts of the package need.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any


def lazy_names(
    package: str, table: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package (PEP 562).

    `table` is a text: each module of the package with a colon, followed by its public names.
    """
    homes, module = {}, ""
    for word in table.split():
        if word.endswith(":"):
            module = f"{package}.{word[:-1]}"
        else:
            homes[word] = module

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(homes[name]), name)

    def list_names() -> list[str]:
        return sorted({*vars(importlib.import_module(package)), *homes})

    return get, list_names, sorted(homes)
