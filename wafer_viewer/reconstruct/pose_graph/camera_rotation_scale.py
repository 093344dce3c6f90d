"""Rotation and scale of the camera axes against the stage axes.

The camera may be rotated by its mounting, and scaled by a wrong pixel size. A camera rotated by 1 mrad shifts every
neighbour by 1.2 px to the side, always in the same direction; stage positions trusted field by field would then
contradict all overlaps at once. Rotation and scale are therefore unknowns that all fields share.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import Form, Numbers

SIGMA = 0.05
"""Prior standard deviation of rotation (rad) and scale (fraction); uncertain values are not applied."""

LEAST_OVERLAPS = 4
"""With fewer overlaps, a single wrong one looks like a wrong pixel size."""

_SIGNIFICANT = 4.0
_WORTH_PX = 0.1
_WRONG_SCALE = 0.03


@dataclass(frozen=True, slots=True)
class CameraAxes:
    """Camera against stage: rotated anticlockwise by `turn` (rad), pixels too large by `scale` (fraction).

    u_turn, u_scale: standard uncertainties; (middle_x_um, middle_y_um): the point where its axes and those of the stage
    agree.
    """

    turn: float = 0.0
    u_turn: float = float("inf")
    scale: float = 0.0
    u_scale: float = float("inf")
    middle_x_um: float = 0.0
    middle_y_um: float = 0.0

    @classmethod
    def of(cls, form: Form) -> CameraAxes:
        """Return the camera axes stored in a form."""
        return cls(form.camera_turn, form.u_camera_turn, form.camera_scale, form.u_camera_scale, *form.middle_um)

    def in_form(self, form: Form) -> Form:
        """Return a copy of a form with these camera axes."""
        return dataclasses.replace(
            form,
            camera_turn=self.turn,
            u_camera_turn=self.u_turn,
            camera_scale=self.scale,
            u_camera_scale=self.u_scale,
            middle_um=(self.middle_x_um, self.middle_y_um),
        )

    def from_stage(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Transform stage coordinates to camera axes."""
        x, y = self.arms(stage_x_um, stage_y_um)
        return stage_x_um + self.scale * x + self.turn * y, stage_y_um + self.scale * y - self.turn * x

    def arms(self, stage_x_um: Numbers, stage_y_um: Numbers) -> tuple[Numbers, Numbers]:
        """Return the vectors from the middle to stage positions."""
        return stage_x_um - self.middle_x_um, stage_y_um - self.middle_y_um

    def notes(self, field_um: float, pixel_um: float) -> tuple[str, ...]:
        """Return operator notes on rotation and scale, if they are significant and shift neighbours noticeably.

        field_um: distance between neighbours. Raises ComputeError when the pixel size cannot be right.
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
    """Return the displacement [n, 2, 2] per unit scale and per rad of rotation, at (x_um, y_um) from the middle."""
    return np.stack((np.column_stack((x_um, y_um)), np.column_stack((y_um, -x_um))), axis=-1)
