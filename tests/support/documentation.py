"""Code that the documentation shows."""

from __future__ import annotations

import re

from tests.support.paths import ROOT


def code_block(page: str, beginning: str) -> str:
    """Return the Python block of a page of the documentation that begins with this line."""
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "assets/docs" / page).read_text(), re.M | re.S)
    (found,) = [block for block in blocks if block.startswith(beginning)]
    return found
