"""One field of each scene of the virtual rig, with the default recipe, against the scene's own truth."""

from __future__ import annotations

import numpy as np

from tests.bench.harness import percent, show
from tests.bench.recipes import DEFAULT
from wafer_viewer.measure.truth_comparison import quality
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
from wafer_viewer.rigs.virtual.optics.optics import Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES

FALSE_UM, PIXEL_UM = 4.0, 0.46729
QUICK = ("stair",)


def show_rig(quick: bool) -> None:
    """What an operator of the virtual rig gets."""
    header = ("scene of the virtual rig", "step um", "window", "kept %", "false %", "RMSE of true um", "bias um")
    show("The virtual rig's scenes, small camera", header, [row(name) for name in (QUICK if quick else SCENES)])


def row(name: str) -> tuple[str | float, ...]:
    scene = SCENES[name]
    height = reconstruct(field_of(name), DEFAULT)
    truth_um = scene.truth(height.x_um[None, :], height.y_um[:, None])
    found = quality(height.z_raw_um, truth_um, FALSE_UM)
    shares = percent(found.completeness_fraction), percent(found.false_fraction, 2)
    window = height.provenance.recipe.window
    return (name, scene.tour_z_step_um, window, *shares, found.true_rmse_um, f"{found.bias_um:+.3f}")


def field_of(name: str) -> FieldStack:
    """One field of a scene's tour."""
    scene, sensor = SCENES[name], Sensor(540, 720)
    renderer = FrameRenderer(scene, Optics(), sensor)
    x_um, y_um = scene.tour_center_um
    z_um = scene.tour_z_start_um + scene.tour_z_step_um * np.arange(scene.tour_frames)
    images = np.stack([renderer.frame(x_um, y_um, z, sensor.nominal_exposure_us, k + 1) for k, z in enumerate(z_um)])
    field = Field(number=1, row=0, col=0, x_um=x_um, y_um=y_um, z_start_um=float(z_um[0]))
    return FieldStack(field, images, z_um, np.ones(len(z_um), bool), PIXEL_UM)
