"""The tour: a job filled in for the sample that a virtual rig brings along."""

from __future__ import annotations

from wafer_viewer.model.devices import Rig
from wafer_viewer.model.plan import FieldGrid, FocusSweep, Job
from wafer_viewer.model.sample import Sample
from wafer_viewer.rigs.config import RigConfig

TOUR_FIELDS = 3


def tour_of(rig: Rig, config: RigConfig) -> Job | None:
    """A 3 x 3 grid where the virtual sample shows most, with its names; None for a real rig."""
    if config.kind != "virtual":
        return None
    from wafer_viewer.rigs.virtual.scene import scene

    shown = scene(config.scene)
    limits = rig.limits
    grid = FieldGrid(
        rows=TOUR_FIELDS, cols=TOUR_FIELDS, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um
    )
    return Job(
        product=shown.title,
        sample=Sample(
            name=f"Virtual {shown.name.replace('_', ' ')}",
            lot="TOUR",
            wafer_id=shown.name,
            product=shown.name,
            operator="tour",
            mount="virtual stage",
            notch="down" if shown.name == "wafer" else "none",
            width_um=shown.width_um,
            height_um=shown.height_um,
        ),
        grid=grid.centred_on(*shown.tour_center_um),
        z_start_um=shown.tour_z_start_um,
        sweep=FocusSweep(z_step_um=shown.tour_z_step_um, n_frames=shown.tour_frames),
    )
