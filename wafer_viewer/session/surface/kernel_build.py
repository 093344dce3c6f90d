"""Compilation of all kernels ahead of their use, for the wheel and after an editable installation."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from wafer_viewer.session.surface.worker_tasks import warm_up_heights, warm_up_stitching

PROCESSES = 2
"""At most: with more of them, several compile the same kernels at the same time."""


def compile_all() -> None:
    """Compile every kernel that a scan on the virtual rig and its surface need, in several processes."""
    with ProcessPoolExecutor(
        min(os.cpu_count() or 1, PROCESSES), mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        for part in [pool.submit(part) for part in PARTS]:
            part.result()


def _scenes() -> None:
    """Compile the virtual camera and every sample that it can look at."""
    from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
    from wafer_viewer.rigs.virtual.optics.optics import Optics
    from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES

    for scene in SCENES.values():
        x_um, y_um = scene.tour_center_um
        FrameRenderer(scene, Optics(), Sensor(48, 64)).frame(x_um, y_um, 0.0, 100.0, 1)


def _deep_frames() -> None:
    """Compile what frames of 16 bits need."""
    import numpy as np

    from wafer_viewer.reconstruct.field_pipeline import warm_up

    warm_up(np.uint16)


def _other_searches() -> None:
    """Compile the focus measures and peak estimators that a recipe can ask for."""
    import numpy as np

    from wafer_viewer.model.surface.focus_measures import BUILT_IN
    from wafer_viewer.model.surface.recipe import Recipe
    from wafer_viewer.reconstruct.field_pipeline import warm_up

    recipes = [Recipe(focus_measure=measure.name, edges="none") for measure in BUILT_IN]
    for recipe in (*recipes, Recipe(peak="argmax", edges="none"), Recipe(peak="gaussian", edges="none")):
        warm_up(np.uint8, recipe)


PARTS = warm_up_heights, _scenes, warm_up_stitching, _deep_frames, _other_searches
"""What is compiled, a process for each."""
