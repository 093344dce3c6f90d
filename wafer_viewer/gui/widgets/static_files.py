"""Style sheets and scripts that the page loads, in the folder ``static``."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parents[1] / "static"


def read_static(*names: str) -> str:
    """Return the text of static files, one after the other."""
    return "\n".join((FOLDER / name).read_text() for name in names)
