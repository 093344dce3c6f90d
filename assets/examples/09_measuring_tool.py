"""
Add a measuring tool
====================

This file is a complete plug-in: the median height of a region over a height that you choose. Once its package is
installed, the page, the command line, jobs, tables and reports have the tool.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.base.plane_faces import area_of
from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.measurement.measuring_tool import MeasuringTool, NumberControl, PlaceAsked
from wafer_viewer.model.measurement.tool_options import OptionsSpec
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region

# %%
# The options are what a user may set. The result is what is kept, with its regions.


class MedianHeightOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options. over_um: height that counts as zero."""

    over_um: float | None = None


class MedianHeight(MeasurementResult, frozen=True, kw_only=True, tag="median_height"):
    """Median height of a region."""

    input_fields: ClassVar[tuple[str, ...]] = ("region",)
    main_fields: ClassVar[tuple[str, ...]] = ("height",)
    region: Region
    height: Length
    points: int


# %%
# The function measures. The context knows the layer, the calibration and whether the surface is simulated.


def median_height(surface, region, *, calibration_valid=True, over_um=None):
    """Measure the median height of a region."""
    reading = MeasurementContext.of(surface, None, calibration_valid)
    area = area_of(reading, region, "region", "the median height")
    height_um = float(np.median(area.points.z_um)) - (over_um or 0.0)
    return MedianHeight(
        **reading.result_fields("", area.level),
        region=region,
        height=reading.length(height_um, None),
        points=len(area.points),
    )


# %%
# The descriptor tells the program everything else: names, regions, options, and where the page places the tool.

TOOL = MeasuringTool(
    name="median_height",
    title="Median height",
    short="Median",
    summary="the median height of a region",
    help="The median height of a region, as JSON. Stage um.",
    how="Drag the region over what is measured.",
    result=MedianHeight,
    measure=median_height,
    places=(PlaceAsked("region", "rectangle", "region", "Two opposite corners of a rectangle."),),
    initial="face",
    group="Faces",
    symbol="M",
    icon="baseline",
    options=MedianHeightOptions,
    controls=(NumberControl("Over, µm", "over_um", "Height that counts as zero; empty: 0", None),),
)

# %%
# The ``pyproject.toml`` of the package names the descriptor:
#
# .. code-block:: toml
#
#    [project.entry-points."wafer_viewer.measuring_tools"]
#    median_height = "my_package.median_height:TOOL"
#
# After ``pip install`` of the package, ``wafer-viewer measure median-height --help`` explains the tool. The function
# works without any installation:

if __name__ == "__main__":
    import matplotlib.pyplot as plt

    import wafer_viewer as wv

    surface = wv.read_surface("scan.wafer")
    face = wv.Region.rectangle(700, 470, 780, 520)
    print(median_height(surface, face, over_um=20.0))

    part = surface.window(face).z_raw_um
    plt.figure(figsize=(6, 3))
    plt.hist(part[np.isfinite(part)] - 20.0, bins=80)
    plt.xlabel("z over 20 µm, µm")
    plt.ylabel("pixels")
