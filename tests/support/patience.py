"""How long tests wait for something that another process or thread does."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE_S = 240.0
"""Kernels may have to be compiled first, on a machine that does other things as well."""


def until(due: Callable[[], object], within_s: float = 120.0) -> None:
    """Wait until it holds. Raises AssertionError when it does not in time."""
    end_s = time.monotonic() + within_s
    while not due():
        assert time.monotonic() < end_s, "it does not hold in time"
        time.sleep(0.005)
