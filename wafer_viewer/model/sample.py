"""The thing under the objective: its names, and how it lies on the stage."""

from __future__ import annotations

from typing import Annotated

from wafer_viewer.model.alignment import Notch
from wafer_viewer.model.spec import NonNegative, Spec, Within


class Sample(Spec, frozen=True, kw_only=True):
    """Asked for before a real scan, filled in for the virtual rig. Width and height are those of its outline, in um."""

    name: str = ""
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    slot: Annotated[int, Within(0, 99)] = 0
    notch: Notch = "none"
    mount: str = ""
    operator: str = ""
    width_um: NonNegative = 0.0
    height_um: NonNegative = 0.0
