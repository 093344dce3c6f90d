"""Figures that the paper reports, by table; None for what our copy of it lacks."""

from __future__ import annotations

from typing import NamedTuple

MEASURES = {"GLV": "glv", "SML": "sml", "TEN": "tenengrad"}
"""Focus measures of the paper, by its abbreviations."""
FILTERED = "_LW"
"""Ending of a method with the paper's filter."""
PAPER_METHODS = tuple(f"{name}{ending}" for name in MEASURES for ending in ("", FILTERED))
CERTIFIED_UM = 399.88
"""Certified height difference of the gauge blocks."""


class PublishedRow(NamedTuple):
    """Row of a table: quantity as in `SurfaceFigures`, title, a value or a text for each method, significant digits."""

    quantity: str
    title: str
    values: tuple[float | str | None, ...] = (None,) * 6
    digits: int = 4


STAIR = (
    PublishedRow("rmse_um", "RMSE, µm", (None,) * 5 + ("−40.7 % of TEN",)),
    PublishedRow("corr", "Corr", (None,) * 5 + ("+7.5 % of TEN",)),
    PublishedRow("psnr_db", "PSNR, dB", (None,) * 5 + ("+38.2 % of TEN",)),
)
"""Table 2, of which the text gives only these changes; the peak of its PSNR is not given."""

SMOOTHNESS = {
    "gauge_blocks": PublishedRow(
        "ssm_um2", "SSM of the gauge blocks, µm²", (2.7236, 1.1496e-4, 2.7468, 1.3596e-4, 2.0579, 8.6162e-5)
    ),
    "wafer": PublishedRow("ssm_um2", "SSM of the wafer, µm²", (703.7733, 0.0570, None, 0.0619, 770.0906, 0.0405)),
}
"""Table 3, by sample."""

HEIGHT = PublishedRow("height_um", "Height, µm", (401.05, 400.09, 397.63, 400.12, 398.24, 399.72), digits=5)
HEIGHT_ERROR = PublishedRow("height_error_um", "Error, µm", (1.17, 0.21, 2.25, 0.24, 1.64, 0.16))
FLATNESS = PublishedRow("flatness_um", "Flatness, µm", (3.69, 1.45, 5.70, 2.06, 5.14, 1.42))
"""Table 4. The paper does not define its flatness."""

TIMES = {
    "gauge_blocks": (
        PublishedRow("acquisition_s", "Acquisition, s", (618,) * 6),
        PublishedRow("frame_ms", "Processing, ms a frame", (38, 47, 38, 48, 38, 48)),
        PublishedRow("stitching_s", "Stitching, s", (16.52, 17.89, 16.72, 16.82, 16.36, 17.51)),
    ),
    "wafer": (
        PublishedRow("acquisition_s", "Acquisition, s"),
        PublishedRow("frame_ms", "Processing, ms a frame", (40, 53, None, None, None, None)),
        PublishedRow("stitching_s", "Stitching, s"),
    ),
}
"""Tables 5 and 6, by sample; of Table 6 the text gives the longest time and the one beside it."""
