"""What the modules of the package say, each parsed once for all tests that ask."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.support.paths import ROOT

MODULES = sorted((ROOT / "wafer_viewer").rglob("*.py"))
DOCUMENTED = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Call:
    """A call: the line, the name of what is called ("" where it is none), and the arguments that are given as True."""

    line: int
    name: str
    switched_on: frozenset[str]


@dataclass(frozen=True, slots=True)
class Parsed:
    """What a module says: its tree would fill the memory.

    strings: all but texts that stand alone, as docstrings do; joins: calls of a method `join`.
    """

    docstrings: tuple[str, ...]
    strings: tuple[str, ...]
    calls: tuple[Call, ...]
    f_strings: tuple[ast.JoinedStr, ...]
    joins: tuple[ast.Call, ...]


@cache
def parsed(module: Path) -> Parsed:
    nodes = list(ast.walk(ast.parse(module.read_text())))
    alone = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = (node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    return Parsed(
        docstrings=tuple(text for node in nodes if isinstance(node, DOCUMENTED) and (text := ast.get_docstring(node))),
        strings=tuple(node.value for node in strings if id(node) not in alone),
        calls=tuple(Call(call.lineno, dotted(call.func), switched_on(call)) for call in calls),
        f_strings=tuple(node for node in nodes if isinstance(node, ast.JoinedStr)),
        joins=tuple(call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "join"),
    )


def dotted(node: ast.expr) -> str:
    """The name `a.b.c` as it is written, "" for anything else."""
    if isinstance(node, ast.Attribute):
        before = dotted(node.value)
        return f"{before}.{node.attr}" if before else ""
    return node.id if isinstance(node, ast.Name) else ""


def switched_on(call: ast.Call) -> frozenset[str]:
    return frozenset(k.arg for k in call.keywords if k.arg and getattr(k.value, "value", None) is True)
