"""What one browser looks at: apart from the widgets that change it, and from the session that all browsers share."""

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
"""What the keys of defects begin with."""


@dataclass(frozen=True, slots=True)
class Tour:
    """A tour that was taken: seconds since 1970 of its begin and of its report, and how many steps were skipped."""

    since_s: float = 0.0
    ended_s: float | None = None
    skipped: int = 0


@dataclass(frozen=True, slots=True)
class View:
    """Camera presets aside, everything a browser may choose for itself.

    show: 0 is the stitched surface, a running number is that field, one below 0 a comparison. range_um None: its own
    0.5 - 99.5 %.
    frame_k: a frame of the field `show`, drawn at its z; slice_z_um: the stitched picture at one z; None: none.
    fields: whether fields and overlaps are drawn over the stitched surface.
    places: where the tool in use measures, as it asks for them (the profile has lines of its own); none: the scene lays
    first ones. options: what was set of each tool. levelling: what heights are read from.
    lines: those of the profiles, at most four; line: the active one, whose numbers are shown;
    plot: what was chosen of their plot.
    why: the place, stage um, whose height is being explained.
    faces: of the gauge blocks, the upper one first; none: they are still to be found. check: which earlier check is
    looked at, by its key; None the one that is being made.
    review: the key of what is under review, None the first; review_filter: which of all are listed; defects: how those
    are listed.
    sheet: what lies over the scene in a review: the defect compared, or all dies stacked onto one.
    everything: whether all of a released job is unfolded, not the four actions of its operator alone.
    counted: of which part of what is shown the numbers are; selection: a rectangle of the stage in um; selecting: a
    drag over the scene selects. brush_um: the range of heights that lights up.
    clip: which points are drawn where the surface is drawn as points; point_px: their size on the screen; depth_shade:
    strength of the shade in hollows; refused: whether points that gates refused are drawn, too. before: what becomes of
    points before the slab along the profile's active line.
    tour: the tour that is under way; None: none is.
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
        """Whether the step is one in which the surface is looked at."""
        return self.step not in ("plan", "acquire")

    @property
    def brush(self) -> Span | None:
        """The range of heights that lights up in this step."""
        return self.brush_um if self.step in ("surface", "measure") else None

    @property
    def clipped(self) -> Clip:
        """What of the points is drawn; only a point cloud is clipped, and cut at the profile's active line."""
        if self.look != "points" or self.step == "gauge":
            return Clip()
        line = self.active_line if self.step == "measure" and self.tool == "profile" else None
        slab = Slab(line, self.before) if line is not None and self.before != "show" else None
        return replace(self.clip, slab=slab)

    @property
    def draws_refused(self) -> bool:
        """Whether the points that gates refused are drawn and counted."""
        return self.refused and self.look == "points" and self.step != "gauge" and self.show >= 0

    @property
    def shows_fields(self) -> bool:
        """Whether the page shows how the fields were placed."""
        return self.fields and self.step == "surface" and self.show == 0

    @property
    def shows_difference(self) -> bool:
        """Whether two surfaces compared are looked at, the second minus the first."""
        asked = comparison_of(self.show)
        return asked is not None and asked[1] is ComparisonFace.DIFFERENCE

    @property
    def active_line(self) -> Region | None:
        """The line whose numbers are shown; None where there is none yet."""
        return self.lines[min(self.line, len(self.lines) - 1)] if self.lines else None

    @property
    def lists_some(self) -> bool:
        """Whether some defects alone are listed."""
        return self.step == "review" and self.defects.narrowed

    @property
    def sheet_over(self) -> Sheet:
        """What lies over the scene now."""
        return self.sheet if self.step == "review" and not self.explains else "none"

    @property
    def explains(self) -> bool:
        """Whether the page says why a pixel has its height."""
        return self.why is not None and self.on_surface

    @property
    def below(self) -> Below:
        """Which curve takes the room below the scene."""
        if self.explains:
            return "why"
        if self.step == "gauge":
            return "gauge"
        if self.step == "review" and self.review is not None and self.review.startswith(OF_DEFECT):
            return "defect"
        return "profile" if self.step == "measure" and self.tool == "profile" else "none"
