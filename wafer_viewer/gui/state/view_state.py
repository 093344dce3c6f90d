"""View state of one browser, separate from its widgets and from the session that all browsers share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from wafer_viewer.gui.state.defect_list_state import DefectListing
from wafer_viewer.gui.state.plot_state import PlotView
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import BeforeSlab, Box, Clip, Slab, Span
from wafer_viewer.model.surface.comparison import ComparisonFace, comparison_of

Step = Literal["plan", "acquire", "surface", "measure", "gauge", "review", "report"]
Look = Literal["surface", "points", "plan"]
ColourBy = Literal["height", "confidence", "slope", "deviation", "form", "overlap", "grey", "origin", "difference"]
Tool = Literal["none"] | ToolName
ReviewFilter = Literal["all", "open", "accepted", "rejected"]
Sheet = Literal["none", "beside", "stack"]
Counted = Literal["all", "view", "selection"]
Below = Literal["none", "profile", "why", "gauge", "defect"]

OF_DEFECT = "defect "
"""Prefix of defect keys."""


@dataclass(frozen=True, slots=True)
class Tour:
    """A tour: start and report time in seconds since 1970, and the number of skipped steps."""

    since_s: float = 0.0
    ended_s: float | None = None
    skipped: int = 0


@dataclass(frozen=True, slots=True)
class View:
    """Settings of one browser, except the camera.

    show: 0 for the stitched surface, a positive number for that field, a negative one for a comparison.
    range_um: colour range; None for the default of 0.5 - 99.5 %.
    frame_k: a frame of the field `show`, drawn at its z; None for none.
    slice_z_um: stitched image at one z; None for none.
    fields: True if fields and overlaps are drawn over the stitched surface.
    places: regions of the active tool, in the order of its inputs (the profile has its own lines); empty: the scene
    places initial ones.
    options: options of each tool.
    levelling: reference of the heights.
    lines: profile lines, at most four.
    line: the active profile line, whose values are shown.
    plot: settings of the profile plot.
    why: position, stage um, of the explained height.
    faces: gauge block faces, the upper one first; empty: not found yet.
    check: key of the displayed earlier check; None for the current one.
    review: key of the item under review; None for the first.
    review_filter: filter of the review list.
    defects: sort order and filters of the defect list.
    sheet: overlay in a review: comparison of the defect, or all dies stacked onto one.
    everything: True if a released job is shown with all settings, not only the four actions of its operator.
    counted: part of the surface that the statistics refer to.
    selection: a rectangle of the stage in um.
    selecting: True if a drag in the scene selects.
    brush_um: highlighted height range.
    clip: clipping of drawn points.
    point_px: point size on the screen.
    depth_shade: strength of the shading in hollows.
    refused: True if points rejected by gates are drawn too.
    before: treatment of points in front of the slab along the active profile line.
    tour: the running tour; None for none.
    """

    step: Step = "plan"
    look: Look = "surface"
    show: int = 0
    colour_by: ColourBy = "height"
    colours: str = "mako"
    range_um: tuple[float, float] | None = None
    exaggeration: float = 3.0
    hillshade: float = 0.8
    all_in_focus: float = 0.0
    frame_k: int | None = None
    slice_z_um: float | None = None
    fields: bool = False
    dark: bool = False
    tool: Tool = "none"
    lines: tuple[Region, ...] = ()
    line: int = 0
    plot: PlotView = PlotView()
    places: tuple[Region, ...] = ()
    options: ToolOptions = ToolOptions()
    levelling: Levelling = Levelling()
    selected: int | None = None
    why: tuple[float, float] | None = None
    faces: tuple[Region, ...] = ()
    check: str | None = None
    review: str | None = None
    review_filter: ReviewFilter = "all"
    defects: DefectListing = DefectListing()
    sheet: Sheet = "none"
    everything: bool = False
    counted: Counted = "all"
    selection: Box | None = None
    selecting: bool = False
    brush_um: Span | None = None
    clip: Clip = Clip()
    point_px: float = 3.0
    depth_shade: float = 0.6
    refused: bool = False
    before: BeforeSlab = "show"
    tour: Tour | None = None

    @property
    def on_surface(self) -> bool:
        """True if the step displays the surface."""
        return self.step not in ("plan", "acquire")

    @property
    def brush(self) -> Span | None:
        """Highlighted height range in this step."""
        return self.brush_um if self.step in ("surface", "measure") else None

    @property
    def clipped(self) -> Clip:
        """Clipping of the drawn points; only a point cloud is clipped, and cut at the active profile line."""
        if self.look != "points" or self.step == "gauge":
            return Clip()
        line = self.active_line if self.step == "measure" and self.tool == "profile" else None
        slab = Slab(line, self.before) if line is not None and self.before != "show" else None
        return replace(self.clip, slab=slab)

    @property
    def draws_refused(self) -> bool:
        """True if points rejected by gates are drawn and counted."""
        return self.refused and self.look == "points" and self.step != "gauge" and self.show >= 0

    @property
    def shows_fields(self) -> bool:
        """True if the page shows the field positions."""
        return self.fields and self.step == "surface" and self.show == 0

    @property
    def shows_difference(self) -> bool:
        """True if the difference of two surfaces is displayed, the second minus the first."""
        asked = comparison_of(self.show)
        return asked is not None and asked[1] is ComparisonFace.DIFFERENCE

    @property
    def active_line(self) -> Region | None:
        """Profile line whose values are shown; None if there is none yet."""
        return self.lines[min(self.line, len(self.lines) - 1)] if self.lines else None

    @property
    def lists_some(self) -> bool:
        """True if the defect list is filtered."""
        return self.step == "review" and self.defects.narrowed

    @property
    def sheet_over(self) -> Sheet:
        """Current overlay of the scene."""
        return self.sheet if self.step == "review" and not self.explains else "none"

    @property
    def explains(self) -> bool:
        """True if the page explains the height of a pixel."""
        return self.why is not None and self.on_surface

    @property
    def below(self) -> Below:
        """Curve in the panel below the scene."""
        if self.explains:
            return "why"
        if self.step == "gauge":
            return "gauge"
        if self.step == "review" and self.review is not None and self.review.startswith(OF_DEFECT):
            return "defect"
        return "profile" if self.step == "measure" and self.tool == "profile" else "none"
