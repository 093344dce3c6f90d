"""View state of one browser, separate from its widgets and from the session that all browsers share.

It is stored in the browser itself. Settings of one dataset are restored for that dataset only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

import msgspec
import viser

from wafer_viewer.model.acquisition.characteristics import CalibrationKind
from wafer_viewer.model.errors import WaferViewerError, parser_errors_as
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.inspection.die_grid import DieNumber
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.sections import OtherSurface
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Positive, Setting, Spec
from wafer_viewer.model.surface.clipping import BeforeSlab, Box, Clip, Slab, Span
from wafer_viewer.model.surface.comparison import ComparisonFace, comparison_of
from wafer_viewer.session.state.snapshot import Fault

# ----------------------------------------------------------------------------------------------------------- view state


DefectSort = Literal["size", "height", "score", "die", "class", "doubt"]
MapBy = Literal["class", "count"] | DieNumber
CLASS_TITLES = {"": "All"} | {kind: look.title for kind, look in DEFECT_CLASSES.items()}


class DefectListing(Spec, frozen=True, kw_only=True):
    """Sort order and filters of the defect list.

    sort: key of the order.
    kind, die: class and die; empty for all.
    map_by: quantity that colours the dies of the map.
    numbers: defects at one position that repeats from die to die, or added since an earlier inspection; empty for all.
    They are forgotten when the surface is searched again.
    """

    sort: DefectSort = "size"
    kind: Annotated[str, Setting("Class", "Only defects of this class", titles=CLASS_TITLES)] = ""
    die: Annotated[str, Setting("Die", "Only this die, as column,row; empty: all")] = ""
    map_by: MapBy = "class"
    numbers: tuple[int, ...] = ()
    least_size_um: Annotated[Positive | None, Setting("Size ≥, µm", "Least length; empty: any")] = None
    most_size_um: Annotated[Positive | None, Setting("Size ≤, µm", "Greatest length; empty: any")] = None
    least_height_um: Annotated[float | None, Setting("Height ≥, µm", "Pits are negative; empty: any")] = None
    most_height_um: Annotated[float | None, Setting("Height ≤, µm", "Pits are negative; empty: any")] = None
    least_confidence: Annotated[Positive | None, Setting("Confidence ≥", "Of the search, up to 1; empty: any")] = None

    @property
    def narrowed(self) -> bool:
        """True if a filter is active."""
        return self.widened != self

    @property
    def widened(self) -> DefectListing:
        """The same list without filters."""
        return DefectListing(sort=self.sort, map_by=self.map_by)

    def holds(self, defect: Defect) -> bool:
        """Return whether a defect passes all filters."""
        return (
            self.kind in ("", defect.seen_as)
            and self.die in ("", defect.die)
            and (not self.numbers or defect.number in self.numbers)
            and _within(defect.major.value_um, self.least_size_um, self.most_size_um)
            and _within(defect.height.value_um, self.least_height_um, self.most_height_um)
            and _within(defect.confidence, self.least_confidence, None)
        )


FILTERED = (*("kind", "die", "least_size_um", "most_size_um", "least_height_um", "most_height_um", "least_confidence"),)
"""Filters that a person sets in the form of the list."""


def _within(value: float, least: float | None, most: float | None) -> bool:
    return (least is None or value >= least) and (most is None or value <= most)


def _rank(die: str) -> tuple[int, ...]:
    """Return the sort key of a die: by rows from the top, positions outside of dies last."""
    parts = tuple(map(int, die.split(","))) if die else ()
    return (0, -parts[1], parts[0]) if parts else (1,)


def _share(defect: Defect) -> float:
    """Return the share of votes for the proposed class of an open defect; others come last."""
    return defect.learned.share if defect.learned is not None and defect.judgement == "open" else 2.0


def _die(defect: Defect) -> tuple[tuple[int, ...], int]:
    return _rank(defect.die), defect.number


SORTS: dict[DefectSort, tuple[str, Callable[[Defect], Any]]] = {
    "size": ("Size", lambda defect: (-defect.major.value_um, defect.number)),
    "height": ("Height", lambda defect: (-abs(defect.height.value_um), defect.number)),
    "score": ("Score", lambda defect: (-defect.score, defect.number)),
    "die": ("Die", _die),
    "class": ("Class", lambda defect: (defect.seen_as, -defect.major.value_um, defect.number)),
    "doubt": ("Doubt", lambda defect: (_share(defect), defect.number)),
}
"""Title on the page and ascending sort key, by name."""


def listed(defects: Iterable[Defect], listing: DefectListing) -> tuple[Defect, ...]:
    """Return the filtered defects in order; unmeasured areas, which are not defects, last."""
    order = SORTS[listing.sort][1]
    return tuple(
        sorted(filter(listing.holds, defects), key=lambda defect: (defect.seen_as == "unmeasured", order(defect)))
    )


def next_die(defects: Iterable[Defect], listing: DefectListing, by: int) -> str | None:
    """Return the next or previous die with open defects, by rows from the top; None if there is none."""
    open_dies = {d.die for d in defects if d.die and d.judgement == "open" and listing.kind in ("", d.seen_as)}
    if not open_dies:
        return None
    order = sorted({*open_dies, listing.die} - {""}, key=_rank)
    ahead = order if by > 0 else order[::-1]
    index = ahead.index(listing.die) + 1 if listing.die else 0
    return next(die for die in (*ahead[index:], *ahead[:index]) if die in open_dies)


def next_kind(defects: Iterable[Defect], listing: DefectListing) -> str:
    """Return the next class, the most frequent first; after the last one the empty string for all classes."""
    kinds = ["", *(kind for kind, _ in Counter(defect.seen_as for defect in defects).most_common())]
    return kinds[(kinds.index(listing.kind) + 1) % len(kinds)] if listing.kind in kinds else ""


@dataclass(frozen=True, slots=True)
class PlotView:
    """Settings of the profile plot.

    cursors: fractions of the active line's length.
    span_um: displayed part of the lines; None for all.
    cleaned: True if the other of measured and filtered heights is drawn too.
    of: another surface drawn along the same line; None for none.
    """

    cursors: tuple[float, float] = (0.0, 1.0)
    span_um: tuple[float, float] | None = None
    cleaned: bool = False
    of: OtherSurface | None = None


def with_cursor(plot: PlotView, number: int, share: float) -> PlotView:
    """Return the plot with one cursor moved to another fraction of the line, clamped to it."""
    share, (first, second) = min(max(share, 0.0), 1.0), plot.cursors
    return replace(plot, cursors=(share, second) if number == 0 else (first, share))


Step = Literal["plan", "acquire", "surface", "measure", "gauge", "review", "report"]
Look = Literal["surface", "points", "plan"]
ColourBy = Literal[
    "height", "confidence", "uncertainty", "slope", "deviation", "form", "overlap", "grey", "origin", "difference"
]
Tool = ToolName
"""Active tool, or none."""
ReviewFilter = Literal["all", "open", "accepted", "rejected"]
Sheet = Literal["none", "beside", "gallery", "stack"]
Pane = Literal["as seen", "height", "picture"]
Compared = Literal["reference", "before"]
Counted = Literal["all", "view", "selection"]
Below = Literal["none", "profile", "why", "gauge", "defect", "live", "calibration"]

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
    sheet: what a review shows over the scene: the defect with its reference, the gallery of all defects, or all dies
    stacked onto one.
    pane: what its pictures show: heights or grey values; "as seen": where the search saw the defect.
    compared: with what: the reference of the inspection, or an earlier scan.
    marked: numbers of the defects that are selected in the gallery.
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
    dark, theme_chosen: dark colours; chosen by a person, else those of the system.
    tour: the running tour; None for none.
    live: True if the step Plan shows the camera.
    jog_step_um: step of the stage in x and y by a key; that in z is a fiftieth.
    instrument: True if the step Gauge check shows the calibrations of the instrument.
    calibration: the displayed kind of calibration.
    focus_row: row of fields whose z windows are shown, in Plan; None for the middle one.
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
    theme_chosen: bool = False
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
    sheet: Sheet = "beside"
    pane: Pane = "as seen"
    compared: Compared = "reference"
    marked: tuple[int, ...] = ()
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
    live: bool = False
    jog_step_um: float = 50.0
    instrument: bool = False
    calibration: CalibrationKind = "delay"
    focus_row: int | None = None

    @property
    def on_surface(self) -> bool:
        """True if the step displays the surface."""
        return self.step not in ("plan", "acquire")

    @property
    def at_bench(self) -> bool:
        """True if the camera is shown live."""
        return self.step == "plan" and self.live

    @property
    def checks_blocks(self) -> bool:
        """True if the page shows the check against gauge blocks."""
        return self.step == "gauge" and not self.instrument

    @property
    def at_instrument(self) -> bool:
        """True if the page shows the calibrations of the instrument."""
        return self.step == "gauge" and self.instrument

    @property
    def brush(self) -> Span | None:
        """Highlighted height range in this step."""
        return self.brush_um if self.step in ("surface", "measure") else None

    @property
    def clipped(self) -> Clip:
        """Clipping of the drawn points; only a point cloud is clipped, and cut at a straight active profile."""
        if self.look != "points" or self.step == "gauge":
            return Clip()
        line = self.active_line if self.step == "measure" and self.tool == "profile" else None
        straight = line is not None and line.kind == "line"
        slab = Slab(line, self.before) if line is not None and straight and self.before != "show" else None
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
        comparison = comparison_of(self.show)
        return comparison is not None and comparison[1] is ComparisonFace.DIFFERENCE

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
        """Current overlay of the scene; one defect is compared only while a defect is under review."""
        shown = self.step == "review" and not self.explains and (self.sheet != "beside" or self.reviews_defect)
        return self.sheet if shown else "none"

    @property
    def reviews_defect(self) -> bool:
        """True if a defect is under review."""
        return self.step == "review" and self.review is not None and self.review.startswith(OF_DEFECT)

    @property
    def explains(self) -> bool:
        """True if the page explains the height of a pixel."""
        return self.why is not None and self.on_surface

    @property
    def below(self) -> Below:
        """Curve in the panel below the scene."""
        if self.explains:
            return "why"
        if self.at_bench:
            return "live"
        if self.step == "gauge":
            return "calibration" if self.instrument else "gauge"
        if self.reviews_defect:
            return "none" if self.sheet == "gallery" else "defect"
        return "profile" if self.step == "measure" and self.tool == "profile" else "none"


# ------------------------------------------------------------------------------------------------------ browser storage


VIEW_KEY, SELF_KEY, CAMERA_KEY = "wafer-viewer-view", "wafer-viewer-browser", "wafer-viewer-camera"
EVERYWHERE = (
    *("step", "look", "colour_by", "colours", "exaggeration", "hillshade", "all_in_focus", "fields", "dark"),
    *("theme_chosen", "point_px", "depth_shade", "tour", "live", "jog_step_um", "instrument", "calibration"),
)
"""View settings that apply to every dataset; all others belong to the dataset they were chosen for."""
OF = "of"
WAIT_S = 15.0
"""Timeout of a storage request. A browser busy with the page answers late; without an answer the page uses defaults."""
Vector = tuple[float, float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PanelLayout:
    """Widths of the side panels in pixels, and their folded state."""

    left_px: int | None = None
    right_px: int | None = None
    left_folded: bool = False
    right_folded: bool = False


@dataclass(frozen=True, slots=True)
class BrowserIdentity:
    """Identity of a browser: session key, name, panel layout and pending notes."""

    key: str = ""
    name: str = ""
    layout: PanelLayout = PanelLayout()
    notes: tuple[Fault, ...] = ()


@dataclass(frozen=True, slots=True)
class SavedCamera:
    """Saved camera position and point looked at, in mm, for the dataset `of`."""

    of: str = ""
    position_mm: Vector = (0.0, 0.0, 0.0)
    look_at_mm: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Remembered:
    """Stored state of a browser: identity, view, and the settings for the dataset `of`."""

    browser: BrowserIdentity = BrowserIdentity()
    view: View = View()
    of: str = ""
    chosen: dict[str, Any] = field(default_factory=dict)
    standpoint: SavedCamera = SavedCamera()


def recall(client: viser.ClientHandle) -> Remembered:
    """Return the stored state of a browser; the default without an answer. All items are requested concurrently."""

    def ask(key: str) -> str:
        return client.local_storage.get_item(key, timeout=WAIT_S) or "{}"

    try:
        with ThreadPoolExecutor(3, thread_name_prefix="recall") as asking:
            view, browser, camera = asking.map(ask, (VIEW_KEY, SELF_KEY, CAMERA_KEY))
    except (RuntimeError, TimeoutError):
        return Remembered()
    return replace(read(view), browser=read_self(browser), standpoint=_as(_items(camera), SavedCamera) or SavedCamera())


def read(text: str) -> Remembered:
    """Return a view from its text; settings unknown to this version are omitted."""
    stored = _items(text)
    chosen = {name: value for name, hint in _hints().items() if (value := _as(stored.get(name), hint)) is not None}
    view = View(**{name: value for name, value in chosen.items() if name in EVERYWHERE})
    rest = {name: value for name, value in chosen.items() if name not in EVERYWHERE}
    return Remembered(view=view, of=str(stored.get(OF, "")), chosen=rest)


def read_self(text: str) -> BrowserIdentity:
    """Return a browser identity from its text."""
    return _as(_items(text), BrowserIdentity) or BrowserIdentity()


def write(view: View, of: str) -> str:
    """Return a view as text, with the dataset it was chosen for."""
    return msgspec.json.encode({**{f.name: getattr(view, f.name) for f in fields(View)}, OF: of}).decode()


def keep(client: viser.ClientHandle, before: View, after: View, of: str) -> None:
    """Store the view in the browser if it has changed."""
    if before != after:
        client.local_storage.set_item(VIEW_KEY, write(after, of))


def keep_self(client: viser.ClientHandle, browser: BrowserIdentity) -> None:
    """Store the identity in the browser."""
    client.local_storage.set_item(SELF_KEY, msgspec.json.encode(browser).decode())


def keep_standpoint(client: viser.ClientHandle, standpoint: SavedCamera) -> None:
    """Store the camera pose in the browser."""
    client.local_storage.set_item(CAMERA_KEY, msgspec.json.encode(standpoint).decode())


def changed(view: View, **changes: Any) -> View:
    """Return a view with some settings changed; unknown names raise TypeError.

    Height ranges are reset when the surface or its zero changes.
    """
    unknown = set(changes) - {f.name for f in fields(View)}
    if unknown:
        raise TypeError(f"A view has no {', '.join(sorted(unknown))}.")
    after = replace(view, **changes)
    if (after.show, after.levelling) == (view.show, view.levelling):
        return after
    return replace(after, brush_um=changes.get("brush_um"), clip=replace(after.clip, heights_um=None))


@cache
def _hints() -> dict[str, Any]:
    return get_type_hints(View)


def _items(text: str) -> dict[str, Any]:
    with suppress(WaferViewerError), parser_errors_as(lambda _: WaferViewerError("It cannot be read.")):
        return msgspec.json.decode(text, type=dict[str, Any])
    return {}


def _as(value: Any, kind: type[T]) -> T | None:
    """Return a value converted to a type; None if that fails, usually for data of another version."""
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, WaferViewerError):
        return None
