"""The sample: identification, orientation on the stage, and its alignment by marks."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec

from wafer_viewer.model.spec import NonNegative, Positive, Setting, Spec, Within

Notch = Literal["down", "left", "up", "right", "none"]
QUARTER_TURNS: dict[Notch, int] = {"down": 0, "left": -1, "up": 2, "right": 1, "none": 0}
"""Anticlockwise quarter turns from a wafer with its notch down to one with this notch, seen from above."""


class AlignmentMark(Spec, frozen=True, kw_only=True):
    """A point that is easy to identify, usually a corner of a die: its name and its wafer coordinates."""

    name: str
    x_um: float
    y_um: float


class Marks(Spec, frozen=True, kw_only=True):
    """Alignment marks of a product: at least two points far apart, in wafer um."""

    places: tuple[AlignmentMark, ...]
    limit_um: Annotated[
        Positive, Setting("Limit, µm", "Largest residual of a mark at which a scan may start", decimals=2, step=0.5)
    ] = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.places) < 2:
            self.refuse("places", "at least 2 corners of dies, far apart")


class Alignment(Spec, frozen=True, kw_only=True):
    """Rigid transform from stage to wafer coordinates: a rotation about the stage origin, then a shift.

    residual_um: largest residual of any mark; n_marks: number of marks in the fit.
    """

    rotation_rad: float = 0.0
    shift_x_um: float = 0.0
    shift_y_um: float = 0.0
    residual_um: NonNegative = 0.0
    n_marks: Annotated[int, Within(0)] = 0

    def to_wafer(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Return the wafer coordinates of a stage position."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        return c * x_um - s * y_um + self.shift_x_um, s * x_um + c * y_um + self.shift_y_um

    def to_stage(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Return the stage coordinates of a wafer position."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        dx, dy = x_um - self.shift_x_um, y_um - self.shift_y_um
        return c * dx + s * dy, -s * dx + c * dy

    @classmethod
    def by_notch(cls, notch: Notch) -> Alignment:
        """Return the alignment expected before marking: wafer centred on the stage, rotated as its notch points."""
        return cls(rotation_rad=-QUARTER_TURNS[notch] * math.pi / 2)


class Sample(Spec, frozen=True, kw_only=True):
    """Identification of the sample, entered before a real scan and preset for the virtual rig.

    width_um, height_um: size of its outline; None, also for 0, if not given.
    """

    name: Annotated[str, Setting("Name", "Name of the sample, used in files and reports")] = ""
    lot: Annotated[str, Setting("Lot", "Lot of the wafer, recorded in the dataset and in reports")] = ""
    wafer_id: Annotated[str, Setting("Wafer id", "As written on the wafer")] = ""
    product: Annotated[str, Setting("Product", "Product on the wafer")] = ""
    slot: Annotated[int, Within(0, 99)] = 0
    notch: Notch = "none"
    mount: str = ""
    operator: Annotated[str, Setting("Operator", "Person at the instrument")] = ""
    width_um: NonNegative | None = None
    height_um: NonNegative | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("width_um", "height_um"):
            if getattr(self, name) == 0:
                msgspec.structs.force_setattr(self, name, None)

    @property
    def size_um(self) -> tuple[float, float] | None:
        """Width and height of its outline; None unless both are given."""
        return None if self.width_um is None or self.height_um is None else (self.width_um, self.height_um)
