"""What the paper reports, for the tables of the benchmarks; what the copy at hand lacks is None."""

from __future__ import annotations

from tests.bench.harness import Cell

METHODS = ("GLV", "GLV_LW", "SML", "SML_LW", "TEN", "TEN_LW")

STAIR: dict[str, tuple[Cell, ...]] = {
    "RMSE": (None,) * 5 + ("-40.7 % of TEN",),
    "Corr": (None,) * 5 + ("+7.5 % of TEN",),
    "PSNR": (None,) * 5 + ("+38.2 % of TEN",),
}
"""Table 2, of which only these changes are told in the text; the peak of its PSNR is not told."""

SMOOTHNESS: dict[str, tuple[Cell, ...]] = {
    "gauge blocks": (2.7236, 1.1496e-4, 2.7468, 1.3596e-4, 2.0579, 8.6162e-5),
    "wafer": (703.7733, 0.0570, None, 0.0619, 770.0906, 0.0405),
}
"""Table 3, SSM."""

BLOCKS_HEIGHT: dict[str, tuple[Cell, ...]] = {
    "height, um": (401.05, 400.09, 397.63, 400.12, 398.24, 399.72),
    "error, um": (1.17, 0.21, 2.25, 0.24, 1.64, 0.16),
    "flatness, um": (3.69, 1.45, 5.70, 2.06, 5.14, 1.42),
}
"""Table 4."""

BLOCKS_TIME: dict[str, tuple[Cell, ...]] = {
    "acquisition, s": (618,) * 6,
    "processing, ms a frame": (38, 47, 38, 48, 38, 48),
    "splicing, s": (16.52, 17.89, 16.72, 16.82, 16.36, 17.51),
}
"""Table 5."""

WAFER_TIME: dict[str, tuple[Cell, ...]] = {"processing, ms a frame": (40, 53, None, None, None, None)}
"""Table 6, of which the text tells the greatest time and the one beside it."""


def rows(table: dict[str, tuple[Cell, ...]]) -> list[tuple[Cell, ...]]:
    """The rows of a table of the paper, with words where the copy at hand has none."""
    return [(name, *("not available" if v is None else v for v in values)) for name, values in table.items()]
