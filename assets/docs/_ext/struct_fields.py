"""Fields of specs as a list: their docstrings name them in sentences, ``rows: …; cols: …``."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from sphinx.application import Sphinx

NUMPYDOC_HEADING = re.compile(r"^-{3,}$")
NESTED_CALL = re.compile(r"([A-Z]\w*)\([^()]*\)")


def fields_of(kind: Any) -> list[str]:
    """Return the names of the fields of a struct or a data class."""
    if dataclasses.is_dataclass(kind):
        return [field.name for field in dataclasses.fields(kind)]
    return list(getattr(kind, "__struct_fields__", ()))


def listed(paragraph: str, names: list[str]) -> list[str]:
    """Return the lines of a paragraph with the fields that it explains as a list; as it is if it explains none."""
    name = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    group = rf"(?:{name})(?:, (?:{name}))*"
    parts = re.split(rf"(?:^|(?<=[;.]) )({group}): ", paragraph)
    if len(parts) == 1:
        return [paragraph]
    lines = [parts[0], ""] if parts[0] else []
    for heads, text in zip(parts[1::2], parts[2::2], strict=True):
        head = ", ".join(f"``{one}``" for one in heads.split(", "))
        lines.append(f"- {head}: {text.rstrip(';')}")
    return lines


def list_fields(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Rewrite the docstring of a class before numpydoc reads it."""
    names = fields_of(obj) if what == "class" else []
    if not names or any(NUMPYDOC_HEADING.match(line.strip()) for line in lines):
        return
    paragraphs = [" ".join(part.split()) for part in "\n".join(lines).split("\n\n")]
    lines[:] = [line for paragraph in paragraphs for line in (*listed(paragraph, names), "")]


def shorten_defaults(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, annotation: str | None
) -> tuple[str | None, str | None] | None:
    """Write a default that is a spec without its fields: ``recipe=Recipe()``."""
    if what != "class" or not signature:
        return None
    inner = signature[1:-1]
    while (shorter := NESTED_CALL.sub("\\1\0", inner)) != inner:
        inner = shorter
    return f"({inner.replace(chr(0), '()')})", annotation


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to the docstrings, ahead of numpydoc."""
    app.connect("autodoc-process-docstring", list_fields, priority=100)
    app.connect("autodoc-process-signature", shorten_defaults, priority=100)
    return {"parallel_read_safe": True}
