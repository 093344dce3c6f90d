"""The words that a decision by measuring can have."""

from __future__ import annotations

from typing import Literal

Word = Literal["pass", "fail", "inconclusive", "no verdict"]
