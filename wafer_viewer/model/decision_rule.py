"""Possible outcomes of a decision by measurement."""

from __future__ import annotations

from typing import Literal

Word = Literal["pass", "fail", "inconclusive", "no verdict"]
