"""Tooltips of inputs and buttons: meaning, unit, limit.

One table by label; limits come from the specs that check the settings. viser shows hints of inputs only: a script
sets the titles of buttons.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets.command import Command
from wafer_viewer.gui.widgets.controls import Gui, add_html, set_prop
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.spec import Spec, limit_of


def _limited(text: str, spec: type[Spec], field: str) -> str:
    """Return a hint with the limit of a field by its spec."""
    return f"{text}; {limit}" if (limit := limit_of(spec, field)) is not None else text


FIELDS: dict[str, str] = {
    # Plan
    "Name": "Name of the sample, used in files and reports",
    "Password": "Of a person who is listed, not that of the page",
    "Lot": "Lot of the wafer, recorded in the dataset and in reports",
    "Wafer": "Number of the wafer in its lot",
    "Wafer id": "As written on the wafer",
    "Product": "Product on the wafer",
    "Operator": "Who is at the instrument",
    "Revision": "Of the job; a released revision cannot be changed",
    "Size, mm": _limited("Width and height of the outline, mm", Sample, "width_um"),
    "Columns, rows": _limited("Fields side by side and one above the other", FieldGrid, "rows"),
    "Overlap, %": "Of neighbouring fields, share of a field's side; 0 to 50 %. Stitching wants 8 % or more",
    "Centre, µm": "Middle of the grid, stage x and y in µm",
    "From, to, µm": "Lowest and highest frame, stage z in µm",
    "Step, µm": _limited("From frame to frame along z, µm", FocusSweep, "z_step_um")
    + "; finer than half the depth of field",
    "Exposure, µs": "Of the live picture and of the search for the focus",
    "Exposures, µs": "One time, or several with commas: the frames of one z are then fused",
    # Surface
    "Show": "The stitched surface, or one field",
    "Colour by": "What the colours mean",
    "Size, px": "Of a point on the screen, at the place looked at",
    "Shade, %": "Shade in hollows, so that points of one colour show their relief; 0 draws none",
    "At least": "Confidence that a point needs to be drawn; 0 draws all",
    "Brush, µm": "Heights that light up in scene, map and profile, µm",
    "Refused points": "Points that gates refused, at the height of their refused peak, coloured by reason",
    "X, µm": "Clip box along X, from and to, stage µm",
    "Y, µm": "Clip box along Y, from and to, stage µm",
    "Z, µm": "Heights of the clip box, from and to, µm over the zero chosen",
    "Numbers of": "All of what is shown, what is in view, or the selection",
    "Colours": "Monotonic in lightness; all but Viridis and Cividis keep their light end on the surface",
    "Range": "Range of values that the colours cover",
    "By hand": "Lowest and highest value of the colours",
    "Height, ×": "Exaggeration of z; 1 is the true shape, at most 20",
    "Hillshade, %": "Light from the north-west; 0 shows colours as the bar does",
    "All-in-focus, %": "Strength of the all-in-focus picture in the colours",
    "One frame": "The field as the camera saw it at one z",
    "One z": "All fields as the camera saw them at one z",
    "Frame": "Number of the frame, from the lowest",
    "z, µm": "Stage z of the frames, µm",
    "Preset": "All settings at once",
    "Drift": "Correction of lateral drift between frames",
    "Focus measure": "Measure of sharpness",
    "Window": "Pixels on a side over which focus is measured; odd",
    "Peak": "Interpolation of the height between two frames",
    "Second window": "Whether a window twice as wide must give the same height",
    "Beside walls": "Treatment of heights beside walls, where light bleeds",
    "Smoothing": "Filter of the heights shown; measurements use the measured heights",
    "Outliers": "Isolated heights to remove",
    "Fill": "Gaps to fill; filled pixels are marked",
    # Compare
    "Compare with": "The other surface",
    "Align": "Registration of one surface to the other before they are subtracted",
    "Keep height and tilt": "Whether they stay as measured, so that a common change shows",
    # Measure
    "Heights from": "Zero of the heights: the stage's, or a plane or form fitted to the surface",
    "Width, µm": "Averaging width across the line, µm; 0 is one pixel",
    "Row": "Number of the row of pixels, 0 the top one",
    "Column": "Number of the column of pixels, 0 the left one",
    "Cursors, µm": "Two places along the line, µm from its start",
    # Gauge check
    "Blocks": "Serial numbers of the blocks, / between them",
    "U (k = 2), µm": "Expanded uncertainty of the certified step",
    "Laboratory": "Who certifies it",
    "Number": "Of the certificate",
    "Issued": "The day, as 2026-03-14",
    "Valid until": "The last day, as 2027-03-14",
    "Signed by": "Who signs the check; recorded in the log and in reports",
    "Done by": "Who changes the z scale; recorded in the log",
    "Reason": "Reason, recorded in the log",
    "Limit, ± µm": "Largest error allowed, on either side; empty: no verdict",
    "Blocks, °C": "Temperature of the blocks; empty: not measured",
    "Tolerance, µm": "Upper limit less lower limit of the product; empty: none",
    "Next in, days": "The next check is due after so many days",
    "Tolerance": "Upper limit less lower, in the unit of the values; empty: that of the job, if any",
    "Method": "How the study is evaluated, both by AIAG",
    # Dialogs
    "Path": "On the machine that runs the viewer; Tab completes it",
    "File name": "A folder before it leads there",
    "z step, µm": _limited("Between two images of the stack, µm", FocusSweep, "z_step_um"),
    "Pixel, µm": "Size of a pixel on the sample, µm; over 0",
    "Pattern": "How files are named, r{row}_c{col}_k{k}.tif; empty for one stack",
    "Format": "The ending of the file follows",
    "One pixel in": "Density: every n-th row and column is written; 1 for all",
    "z unit": "Unit of the heights of a surface file, such as um; of points the unit of x and y, too",
    "Depths": "The file holds depths, positive downward: they are inverted",
    "Limit, µm": "How far a mark may lie from where the alignment puts it, µm",
    "Measured as": "Typed in, or as a result that was kept: its tool, places and settings",
    "Quantity": "Which number of the result is judged",
    "Nominal, µm": "Nominal value, µm or the unit of the quantity",
    "Lower limit": "In µm or the unit of the quantity; empty: the upper one alone holds",
    "Upper limit": "In µm or the unit of the quantity; empty: the lower one alone holds",
    "On every die": "Measured at the same place on each die; the plan must name the dies",
    "Die, µm": "Width and height of a die",
    "Pitch, µm": "From die to die, to the right and upwards",
    "First die, µm": "Lower left corner of the lowest die at the left, wafer µm",
    "Across, up": "How many dies side by side, and one above the other",
    "Dataset or folder": "A stored NAME.wafer, or a folder of them",
    "Reconstruction": "Name of the result that is judged",
    "Rule": "Guard band: value ± U must lie within the limits",
    "x, y, µm": "Where the mark is on the wafer, µm",
    "– to, µm": "The opposite corner, µm",
    "Your name": "Shown to the other browsers",
}
BUTTONS: dict[str, str] = {
    "Horizontal cut": "Horizontal cut",
    "Vertical cut": "Vertical cut",
    "Add line": "Add a profile line",
    "Start scan": "Scan, pause, continue",
    "Pause": "Scan, pause, continue",
    "Continue": "Scan, pause, continue",
    "Stop": "Stop all motion",
    "Stop scan": "Stop all motion",
    "Cover the sample": "Cover the sample",
    "Save plan…": "Save plan…",
    "Open…": "Open a dataset…",
    "Import…": "Import images…",
    "Export…": "Export the surface…",
    "0.5 – 99.5 %": "Colours from 0.5 to 99.5 %",
    "Delete": "Delete the result",
    "Keep result": "Keep the result",
    "Undo": "Undo",
    "Redo": "Redo",
    "Next": "Next under review",
    "Accept": "Accept",
    "Reject": "Reject",
}
"""Labels of buttons, and the commands whose keys do the same."""
STEP_TITLES = "Plan", "Acquire", "Surface", "Measure", "Gauge check", "Review", "Report"


def add_hints(gui: Gui) -> None:
    """Set the hint of each existing input that has none."""
    for handle in dict(gui._gui_input_handle_from_uuid).values():
        given: Any = getattr(handle, "hint", "")
        text = FIELDS.get(getattr(handle, "label", "") or "")
        if given is None and text is not None:
            set_prop(handle, "hint", text)


def add_titles(page: Page, commands: Sequence[Command]) -> None:
    """Add the keys of commands to the titles of their buttons."""
    titles = json.dumps(titles_of(commands), ensure_ascii=False)
    add_html(page.gui, Markup('<div hidden data-titles="{}"></div>').format(titles))


def titles_of(commands: Sequence[Command]) -> dict[str, str]:
    """Return the title of each button: its key."""
    keys = {command.name: command.spoken_key for command in commands if command.key}
    named = {**BUTTONS, **{step: step for step in STEP_TITLES}}
    return {label: f"Key {keys[name]}" for label, name in named.items() if name in keys}
