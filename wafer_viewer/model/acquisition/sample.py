"""The sample: its identification and its orientation on the stage."""

from __future__ import annotations

from typing import Annotated

import msgspec

from wafer_viewer.model.acquisition.alignment import Notch
from wafer_viewer.model.spec import NonNegative, Spec, Within


class Sample(Spec, frozen=True, kw_only=True):
    """Identification of the sample, entered before a real scan and preset for the virtual rig.

    width_um, height_um: size of its outline; None if not given (0 in files of older versions).
    """

    name: str = ""
    lot: str = ""
    wafer_id: str = ""
    product: str = ""
    slot: Annotated[int, Within(0, 99)] = 0
    notch: Notch = "none"
    mount: str = ""
    operator: str = ""
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
