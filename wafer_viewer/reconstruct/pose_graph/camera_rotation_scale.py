"""How the camera's axes lie against the stage's: turned by its mounting, longer or shorter by a wrong pixel size.

A camera turned by 1 mrad shifts every neighbour by 1.2 px to the side, always the same way; a stage that was believed
field by field would pull against all overlaps at once. So turn and scale are unknowns that all fields share.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import Form, Numbers

SIGMA = 0.05
"""Of turn (rad) and scale (fraction) before anything is measured: what is not certain is not applied, however small."""

LEAST_OVERLAPS = 4
"""With fewer, one that is wrong looks like a wrong pixel size."""

_SIGNIFICANT = 4.0
_WORTH_PX = 0.1
_WRONG_SCALE = 0.03


@dataclass(frozen=True, slots=True)
class CameraAxes:
    """The camera against the stage: turned anticlockwise by `turn` (rad), its pixels too large by `scale` (fraction).

    u_turn, u_scale: standard uncertainties; (middle_x_um, middle_y_um): where its axes and those of the stage agree.
    """

    turn: float = 0.0
    u_turn: float = float("inf")
    scale: float = 0.0
    u_scale: float = float("inf")
    middle_x_um: float = 0.0
    middle_y_um: float = 0.0

    @classmethod
    def of(cls, form: Form) -> CameraAxes:
        """The camera that a form tells of."""
        return cls(form.camera_turn, form.u_camera_turn, form.camera_scale, form.u_camera_scale, *form.middle_um)

    def in_form(self, form: Form) -> Form:
        """A form that tells of this camera."""
        return dataclasses.replace(
            form,
            camera_turn=self.turn,
            u_camera_turn=self.u_turn,
            camera_scale=self.scale,
            u_camera_scale=self.u_scale,
            middle_um=(self.middle_x_um, self.middle_y_um),
        )

    def from_stage(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Where places of the stage lie in the camera's axes."""
        x, y = self.arms(stage_x_um, stage_y_um)
        return stage_x_um + self.scale * x + self.turn * y, stage_y_um + self.scale * y - self.turn * x

    def arms(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """From the middle to places of the stage."""
        return stage_x_um - self.middle_x_um, stage_y_um - self.middle_y_um

    def notes(self, field_um: float, pixel_um: float) -> tuple[str, ...]:
        """What the operator should know of it: turn and scale, where they are certain and move neighbours noticeably.

        field_um: how far neighbours are apart. Raises ComputeError when the pixel size cannot be right.
        """
        notes: list[str] = []
        if self._matters(self.turn, self.u_turn, field_um, pixel_um):
            turned = f"{abs(self.turn) * 1e3:.2f} mrad {'anticlockwise' if self.turn > 0 else 'clockwise'}"
            notes.append(f"The camera is turned by {turned} against the stage: calibrate its angle.")
        if self._matters(self.scale, self.u_scale, field_um, pixel_um):
            found_um = pixel_um / (1 + self.scale)
            said = f"The overlaps say a pixel is {found_um:.5g} um, not {pixel_um:.5g} um"
            if abs(self.scale) > _WRONG_SCALE:
                raise ComputeError(f"{said}: give the pixel size of this objective and camera.")
            notes.append(f"{said}: calibrate the pixel size.")
        return tuple(notes)

    def _matters(self, value: float, u: float, field_um: float, pixel_um: float) -> bool:
        return abs(value) > _SIGNIFICANT * u and abs(value) * field_um > _WORTH_PX * pixel_um


def shared_by_all(x_um: Numbers, y_um: Numbers) -> Numbers:
    """[n, 2, 2] by how much a scale of 1 and a turn of 1 rad move what lies (x_um, y_um) from the middle."""
    return np.stack((np.column_stack((x_um, y_um)), np.column_stack((y_um, -x_um))), axis=-1)
