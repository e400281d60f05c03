"""The names of rclpy that a module imports, and the calls of them."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

MANY = "[]"


@dataclass(frozen=True)
class Use:
    """A name of rclpy in a line, and the keywords of its call."""

    name: str
    line: int
    keywords: tuple[str, ...] = ()


class Reader(ast.NodeVisitor):
    """Reads one module.

    `kinds` says what an expression is of rclpy: `node` -> `rclpy.node.Node`, whether that class or
    an instance; `[]` after it stands for a container of them. `gives` says what a call or a
    property gives.
    """

    def __init__(self, gives: Mapping[str, str]) -> None:
        self.gives = gives
        self.kinds: dict[str, str] = {}
        self.own: frozenset[str] = frozenset()
        self.found: set[Use] = set()

    def kind(self, node: ast.AST | None) -> str | None:
        """Return the name in rclpy of an expression's value, or None."""
        if isinstance(node, ast.Attribute):
            name = self.name(node)
            return self.kinds.get(ast.unparse(node), name and self.gives.get(name, name))
        if isinstance(node, ast.Name):
            return self.kinds.get(node.id)
        if isinstance(node, ast.Call):
            if ast.unparse(node) == "super()":
                return self.kinds.get("self")
            name = self.name(node.func) or self.kind(node.func)
            is_class = name is not None and name.rpartition(".")[2][0].isupper()
            return name and self.gives.get(name, name if is_class else None)
        return None

    def name(self, node: ast.AST) -> str | None:
        """Return the dotted name that an attribute has in rclpy, or None."""
        if not isinstance(node, ast.Attribute):
            return None
        if ast.unparse(node) in self.own:
            return None
        owner = self.kind(node.value)
        return f"{owner}.{node.attr}" if owner and not owner.endswith(MANY) else None

    def visit_Import(self, node: ast.Import) -> None:
        for each in node.names:
            if each.name.split(".")[0] == "rclpy":
                self.found.add(Use(each.name, node.lineno))
                self.kinds["rclpy"] = "rclpy"

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if str(node.module).split(".")[0] == "rclpy":
            for each in node.names:
                name = f"{node.module}.{each.name}"
                self.found.add(Use(name, node.lineno))
                self.kinds[each.asname or each.name] = name

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        before, own = dict(self.kinds), self.own
        for base in map(self.kind, node.bases):
            if base is not None:
                self.kinds["self"] = base
        self.own = frozenset(f"self.{name}" for name in _members(node))
        for each in ast.walk(node):  # attributes may be set below the method that uses them
            if isinstance(each, ast.FunctionDef):
                self._enter(each)
                for line in ast.walk(each):
                    self._learn(line)
        self.generic_visit(node)
        self.kinds, self.own = before, own

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        before = dict(self.kinds)
        self._enter(node)
        self.generic_visit(node)
        kept = {text: kind for text, kind in self.kinds.items() if text.startswith("self.")}
        self.kinds = {**before, **kept}

    def _enter(self, node: ast.FunctionDef) -> None:
        for each in [*node.args.args, *node.args.kwonlyargs]:
            self._note(each.arg, self._annotated(each.annotation))

    def _annotated(self, annotation: ast.AST | None) -> str | None:
        parts = ast.walk(annotation) if annotation is not None else []
        kind = next((kind for kind in map(self.kind, parts) if kind), None)
        is_inside = isinstance(annotation, ast.Subscript) and not self.kind(annotation.value)
        return f"{kind}{MANY}" if kind and is_inside else kind

    def _note(self, text: str, kind: str | None) -> None:
        if kind:
            self.kinds[text] = kind

    def _learn(self, node: ast.AST) -> None:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                for each, value in _pairs(target, node.value):
                    self._note(ast.unparse(each), self.kind(value))
        elif isinstance(node, ast.AnnAssign):
            kind = self._annotated(node.annotation) or self.kind(node.value)
            self._note(ast.unparse(node.target), kind)
        elif isinstance(node, (ast.For, ast.comprehension)):
            each = self.kind(node.iter)
            if each and each.endswith(MANY):
                self._note(ast.unparse(node.target), each.removesuffix(MANY))

    def visit_Call(self, node: ast.Call) -> None:
        name = self.name(node.func) or self.kind(node.func)
        if name:
            keywords = tuple(sorted(each.arg for each in node.keywords if each.arg))
            self.found.add(Use(name, node.lineno, keywords))
        self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        name = self.name(node)
        if name:
            self.found.add(Use(name, node.lineno))
        self.generic_visit(node)

    def generic_visit(self, node: ast.AST) -> None:
        if isinstance(node, (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp)):
            for each in node.generators:
                self._learn(each)
        self._learn(node)
        super().generic_visit(node)


def _pairs(target: ast.expr, value: ast.expr) -> list[tuple[ast.expr, ast.expr]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return list(zip(target.elts, value.elts, strict=False))
    return [(target, value)]


def _members(node: ast.ClassDef) -> Iterator[str]:
    for each in ast.walk(node):
        if isinstance(each, ast.FunctionDef):
            yield each.name
        elif isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store):
            yield each.attr


def uses(text: str, gives: Mapping[str, str]) -> list[Use]:
    """List what a module uses of rclpy, by line.

    Parameters
    ----------
    text : str
        Its source.
    gives : mapping of str to str
        What a call or a property gives: `rclpy.node.Node.get_clock` -> `rclpy.clock.Clock`.
    """
    reader = Reader(gives)
    reader.visit(ast.parse(text))
    return sorted(reader.found, key=lambda use: (use.line, use.name, use.keywords))
