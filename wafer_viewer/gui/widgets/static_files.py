"""Style sheets and scripts that the page loads, in the folder ``static``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "static"


def read_static(*names: str) -> Sequence[str]:
    """Return the text of static files."""
    return [(FOLDER / name).read_text() for name in names]
