"""Size of the package by room: modules, lines and tuned numbers.

A tuned number is a field with a numeric default of a class whose name ends in Tuning, Priors,
Options, Limits or Tolerances, or a constant of a module in capitals with a numeric value. A room
is a folder of `magcal_ros/core`, or another folder of `magcal_ros`. Run it as
`python benchmarks/house.py [folder of the package]`.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "magcal_ros"
TUNED = ("Tuning", "Priors", "Options", "Limits", "Tolerances")


def room_of(module: Path) -> str:
    """Return the room of a module, given by its path in the package."""
    depth = 2 if module.parts[0] == "core" else 1
    return "/".join(module.parts[:-1][:depth]) or "magcal_ros"


def is_numeric(value: ast.expr | None) -> bool:
    """Return whether an expression is a number, several, or reckoned from numbers."""
    match value:
        case ast.Constant():
            return type(value.value) in (int, float)
        case ast.UnaryOp():
            return is_numeric(value.operand)
        case ast.BinOp():
            return is_numeric(value.left) or is_numeric(value.right)
        case ast.Tuple() | ast.List():
            return any(map(is_numeric, value.elts))
        case ast.Call(func=ast.Attribute(value=ast.Name(id="math" | "np"))):
            return any(map(is_numeric, value.args))
        case _:
            return False


def default_of(field: ast.stmt) -> ast.expr | None:
    """Return the default of a dataclass's field, also where `field(default=…)` gives it."""
    value = field.value if isinstance(field, ast.AnnAssign) else None
    if isinstance(value, ast.Call) and ast.unparse(value.func).endswith("field"):
        return next((each.value for each in value.keywords if each.arg == "default"), None)
    return value


def constants(module: ast.Module) -> Iterator[str]:
    for line in module.body:
        if isinstance(line, ast.Assign | ast.AnnAssign) and is_numeric(line.value):
            targets = line.targets if isinstance(line, ast.Assign) else [line.target]
            names = [name for each in targets for name in ast.walk(each)]
            yield from (n.id for n in names if isinstance(n, ast.Name) and n.id.isupper())


def tuned_fields(module: ast.Module) -> Iterator[str]:
    for each in ast.walk(module):
        if isinstance(each, ast.ClassDef) and each.name.endswith(TUNED):
            defaults = map(default_of, each.body)
            yield from (each.name for default in defaults if is_numeric(default))


def main(package: Path = PACKAGE) -> None:
    modules, lines, fields, named = (Counter[str]() for _ in range(4))
    for path in sorted(package.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree, room = ast.parse(text), room_of(path.relative_to(package))
        modules[room] += 1
        lines[room] += len(text.splitlines())
        fields[room] += len(list(tuned_fields(tree)))
        named[room] += len(list(constants(tree)))
    row = "{:24}{:>9}{:>9}{:>9}{:>11}".format
    print(row("room", "modules", "lines", "fields", "constants"))
    for room in sorted(modules):
        print(row(room, modules[room], lines[room], fields[room], named[room]))
    print(row("core, all of it", *(of_core(each) for each in (modules, lines, fields, named))))
    print(row("all", modules.total(), lines.total(), fields.total(), named.total()))


def of_core(counts: Counter[str]) -> int:
    return sum(count for room, count in counts.items() if room.split("/")[0] == "core")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
