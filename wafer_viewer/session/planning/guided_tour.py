"""Guided tour: a complete job for the sample of the virtual rig.

For the virtual wafer its grid, on the small camera, is 3 x 3 fields of 37 frames over the nine middle dies of the scene
`tour_wafer`.
"""

from __future__ import annotations

from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.rigs.rig_config import RigConfig

TOUR_FIELDS = 3
TOUR_LOT = "TOUR"


def is_tour(job: Job | None) -> bool:
    """Return whether a job is the job of the tour."""
    return job is not None and job.sample.lot == TOUR_LOT


def tour_of(rig: Rig, config: RigConfig) -> Job | None:
    """Return the tour job of the virtual rig: a grid over the most interesting area of its sample.

    None for a real rig.
    """
    if config.kind != "virtual":
        return None
    from wafer_viewer.rigs.virtual.rig import VIRTUAL_MOUNT
    from wafer_viewer.rigs.virtual.scenes.catalogue import scene

    shown = scene(scene(config.scene).tour_scene or config.scene)
    size = {"field_width_um": rig.limits.field_width_um, "field_height_um": rig.limits.field_height_um}
    grid = FieldGrid(rows=TOUR_FIELDS, cols=TOUR_FIELDS, **size)
    if shown.tour_area_um is not None:
        grid = FieldGrid.covering(*shown.tour_area_um, **size)
    return Job(
        product=shown.title,
        sample=Sample(
            name=f"Virtual {shown.name.replace('_', ' ')}",
            lot=TOUR_LOT,
            wafer_id=shown.name,
            product=shown.name,
            operator="tour",
            mount=VIRTUAL_MOUNT,
            notch="down" if shown.dies is not None else "none",
            width_um=shown.width_um,
            height_um=shown.height_um,
        ),
        grid=grid.centred_on(*shown.tour_center_um),
        z_start_um=shown.tour_z_start_um,
        sweep=FocusSweep(z_step_um=shown.tour_z_step_um, n_frames=shown.tour_frames),
    )
