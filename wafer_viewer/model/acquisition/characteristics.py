"""Results and records of calibrations: characteristics of the instrument with their expanded uncertainties."""

from __future__ import annotations

import datetime
from typing import Any, ClassVar, Literal

import msgspec

from wafer_viewer.model.acquisition.calibration import Calibration, FlatField, OpticalSetup
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Count, NonNegative, Spec, replace

CalibrationKind = Literal[
    "delay", "pixel", "flat-field", "noise", "flatness", "mapping", "resolution", "z", "linearity"
]
CalibrationSource = Literal["rig", "gauge checks"]
"""Source of a calibration: a procedure on the rig, or signed checks against gauge blocks, for which nothing moves."""


FOCUS_RANGE_UM = 100.0
"""Default range about the present z in which a calibration searches the focus, um."""


class CalibrationOption(Spec, frozen=True, kw_only=True):
    """Option of a calibration on the rig: field of its procedure, label, sentence of help, unit and default.

    default: an int for a count, a float for another number, None for a number that may be left out.
    """

    name: str
    title: str
    about: str
    unit: str = ""
    default: int | float | None


class KindOfCalibration(Spec, frozen=True, kw_only=True):
    """Descriptor of a kind of calibration: its texts, needs, source, options, and the days until it is due.

    against: standard of the pixel size, where the kind sets it. The table `KINDS` lists them in the order in which an
    instrument is calibrated; command line, list and page read it.
    """

    title: str
    about: str
    needs: str
    interval_days: int
    source: CalibrationSource = "rig"
    options: tuple[CalibrationOption, ...] = ()
    against: str = ""


KINDS: dict[CalibrationKind, KindOfCalibration] = {
    "delay": KindOfCalibration(
        title="Trigger delay",
        about="Find the delay from the pulse to the exposure by sweeps of one field upward and downward at two speeds.",
        needs="one field with texture, in focus",
        interval_days=365,
        options=(CalibrationOption(name="repeats", title="Pairs", about="Pairs of sweeps at each speed.", default=4),),
    ),
    "pixel": KindOfCalibration(
        title="Pixel size and camera rotation",
        about="Find the pixel size and the camera's rotation by frames along lines of known stage moves.",
        needs="texture over the lines, such as a ground plate or a patterned wafer",
        interval_days=365,
        options=(
            CalibrationOption(name="n_lines", title="Lines", about="Lines along each axis.", default=4),
            CalibrationOption(name="length_um", title="Length", about="Length of a line.", unit="um", default=5_000.0),
            CalibrationOption(
                name="spread_um",
                title="Spread",
                about="Distance from the first to the last line of an axis.",
                unit="um",
                default=10_000.0,
            ),
            CalibrationOption(
                name="u_stage_fraction",
                title="u of the stage",
                about="Relative u (k = 1) of the stage's scales, from their certificate.",
                default=1e-5,
            ),
        ),
        against="the scales of the stage",
    ),
    "flat-field": KindOfCalibration(
        title="Flat field and dark level",
        about="Measure shading and dark level of the image at several places of a flat, out of focus.",
        needs="a blank flat, such as a ground plate, several fields wide",
        interval_days=90,
        options=(
            CalibrationOption(
                name="n_side", title="Places", about="Places along each side of a square of fields.", default=4
            ),
            CalibrationOption(
                name="frames", title="Frames", about="Frames that are averaged at each place and exposure.", default=4
            ),
            CalibrationOption(
                name="defocus",
                title="Defocus",
                about="Distance of the frames above the focus, in depths of field.",
                unit="depths of field",
                default=12.0,
            ),
            CalibrationOption(
                name="dark_counts",
                title="Dark level",
                about="Mean counts with the light covered, for a strobe; by two exposures without it.",
                unit="counts",
                default=None,
            ),
        ),
    ),
    "noise": KindOfCalibration(
        title="Measurement noise",
        about="Measure the noise of the heights by repeated scans of one field.",
        needs="one field of a smooth flat with texture",
        interval_days=90,
        options=(CalibrationOption(name="repeats", title="Scans", about="Scans of the field.", default=6),),
    ),
    "flatness": KindOfCalibration(
        title="Flatness deviation",
        about="Measure the flatness deviation by the mean heights of several places of a flat.",
        needs="a flat with texture, several fields wide",
        interval_days=365,
        options=(
            CalibrationOption(
                name="n_side", title="Places", about="Places along each side of a square of fields.", default=3
            ),
        ),
    ),
    "mapping": KindOfCalibration(
        title="x-y mapping deviation",
        about="Measure the distortion of the image by moving patches of texture to a grid of places in the field.",
        needs="texture over a few fields, such as a ground plate or a patterned wafer",
        interval_days=365,
        options=(
            CalibrationOption(
                name="n_cols", title="Columns", about="Places of a patch along the longer side of the field.", default=7
            ),
            CalibrationOption(
                name="n_rows", title="Rows", about="Places of a patch along the shorter side of the field.", default=5
            ),
            CalibrationOption(
                name="repeats", title="Patches", about="Patches, each at another place of the stage.", default=5
            ),
            CalibrationOption(
                name="spread_um",
                title="Spread",
                about="Distance from the first to the last patch.",
                unit="um",
                default=10_000.0,
            ),
        ),
    ),
    "resolution": KindOfCalibration(
        title="Lateral resolution",
        about="Measure the width of the response to a step by the heights across a straight steep edge.",
        needs="a straight steep step across the field, such as the edge of a die or of a step standard",
        interval_days=365,
        options=(
            CalibrationOption(
                name="span_um",
                title="Span",
                about="Side of the square about the middle of the field that is evaluated; all of it by default.",
                unit="um",
                default=None,
            ),
        ),
    ),
    "z": KindOfCalibration(
        title="z scale",
        about="Set the z scale by a signed check against gauge blocks.",
        needs="a signed check against gauge blocks",
        interval_days=365,
        source="gauge checks",
    ),
    "linearity": KindOfCalibration(
        title="Amplification and linearity of z",
        about="Evaluate amplification and linearity of z from the signed checks against gauge blocks.",
        needs="signed checks against gauge blocks",
        interval_days=365,
        source="gauge checks",
    ),
}
NOT_MEASURED: dict[str, str] = {
    "topographic spatial resolution": "needs a certified star-shaped groove (type ASG)",
    "topography fidelity": "needs a certified profile of known form",
    "x-y mapping deviation against a length standard": "needs a certified grid; the scales of the stage serve here",
}
"""Characteristics of ISO 25178-600 that no procedure here measures, and what they need."""


class Characteristic(Spec, frozen=True, kw_only=True):
    """Property of the instrument: value, unit and expanded uncertainty (k = 2), with the standard that defines it."""

    error: ClassVar[type[WaferViewerError]] = RigError
    name: str
    value: float
    unit: str
    expanded: NonNegative
    standard: str = ""
    before: float | None = None


class CalibrationResult(Spec, frozen=True, kw_only=True):
    """Result of a calibration that nobody has accepted yet.

    sets: fields of `Calibration` with their new values; empty if the characteristics are for information. flat_field:
    maps whose digest is set; a record names the digest alone. interval_days: days until it is due; None for as usual
    for its kind.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    kind: CalibrationKind
    characteristics: tuple[Characteristic, ...]
    sets: dict[str, float | str | tuple[str, ...]] = msgspec.field(default_factory=dict)
    flat_field: FlatField | None = None
    interval_days: Count | None = None
    notes: tuple[str, ...] = ()

    def applied_to(self, before: Calibration, made: str, due: str) -> Calibration:
        """Return the calibration with the values of this result."""
        if not self.sets:
            return before
        values: dict[str, Any] = self.sets
        return replace(before, **values, made=made, due=due, against=KINDS[self.kind].against or before.against)


class CalibrationRecord(Spec, frozen=True, kw_only=True):
    """Accepted calibration: its result, the rig, who signed it and when, and the calibration before and after.

    at: ISO 8601 with time; due: ISO 8601 day until which it is valid.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    software_version: str
    rig: str
    simulated: bool
    setup: OpticalSetup
    at: str
    due: str
    signed_by: str
    why: str = ""
    result: CalibrationResult
    before: Calibration
    after: Calibration

    def is_due(self, today: str) -> bool:
        """Return whether it is no longer valid on a day, ISO 8601."""
        return today > self.due


def due_day(result: CalibrationResult, today: str) -> str:
    """Return the day until which a calibration made today is valid."""
    days = KINDS[result.kind].interval_days if result.interval_days is None else result.interval_days
    return (datetime.date.fromisoformat(today) + datetime.timedelta(days=days)).isoformat()
