"""Gauge capability: Cg and Cgk of repeats on one pair of gauge blocks, against the product's tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, stdev

from wafer_viewer.model.gauge.run_chart import Capability

LEAST_REPEATS = 25
"""Smallest number of repeats for a verdict; each is a new scan."""
LEAST = 1.33
"""Lower limit of Cg and of Cgk."""
VARIANT = "Cg = 0.2 T / (6 s), Cgk = (0.1 T - |mean error|) / (3 s), both >= 1.33 over 25 repeats"


def capability(errors_um: Sequence[float], tolerance_um: float) -> Capability:
    """Return Cg and Cgk from errors of single scans, for a product's tolerance T (upper less lower limit)."""
    n = len(errors_um)
    mean_um = fmean(errors_um) if n else 0.0
    s_um = stdev(errors_um) if n > 1 else None
    cg = 0.2 * tolerance_um / (6 * s_um) if s_um else None
    cgk = (0.1 * tolerance_um - abs(mean_um)) / (3 * s_um) if s_um else None
    capable = None if cg is None or cgk is None or n < LEAST_REPEATS else min(cg, cgk) >= LEAST
    return Capability(
        n=n,
        tolerance_um=tolerance_um,
        mean_um=mean_um,
        s_um=s_um,
        cg=cg,
        cgk=cgk,
        capable=capable,
        why=_why(n, s_um, capable),
        variant=VARIANT,
    )


def _why(n: int, s_um: float | None, capable: bool | None) -> str:
    if n < LEAST_REPEATS:
        return f"There are {n} of {LEAST_REPEATS} repeats: fewer give no verdict."
    if not s_um:
        return "The repeats do not differ at all: the instrument rounds, or one scan was counted several times."
    return f"Both are at least {LEAST}." if capable else f"One is under {LEAST}."
