"""Watch over the z windows of a scan that follows the focus: fields whose focus touches an end are taken again, wider.

The sharpness of every frame is measured when it is stored. A field with heights in focus at an end of its window, or
without any focus in it, is named in the journal; after the last leg it gets a window that is longer by its own length
at that end, and so on up to the whole sweep.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.focus_windows import replanned, widened
from wafer_viewer.acquire.tile_sharpness import sharpness, tile_peaks, touched_ends
from wafer_viewer.model.acquisition.focus_following import FOLLOW_FOCUS
from wafer_viewer.model.acquisition.focus_stack import Frame
from wafer_viewer.model.acquisition.plan import MIN_FRAMES, Field, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.job import Job
from wafer_viewer.store.dataset.writer import DatasetWriter

NAMED = 8
"""Largest number of fields that a message names."""


class FocusWatch:
    """Focus of the fields of a running scan, and the windows that are too short."""

    def __init__(self, writer: DatasetWriter, job: Job, limits: RigLimits) -> None:
        self._writer, self._limits = writer, limits
        self._whole = {field.number: field for field in job.all_fields()}
        self._n_frames = {field.number: field.n_frames for field in writer.record.plan.fields}
        self._frames: dict[int, dict[int, tuple[float, NDArray[np.float64]]]] = defaultdict(dict)

    def add(self, frame: Frame) -> None:
        """Measure the sharpness of a frame of the first exposure."""
        if frame.image is not None and frame.shot.exposure == 0:
            self._frames[frame.shot.field][frame.shot.k] = frame.z_um, sharpness(frame.image)

    def judge(self, number: int) -> None:
        """Record in the journal that a complete field has heights in focus at an end of its window."""
        frames = self._frames.pop(number, {})
        if len(frames) < MIN_FRAMES:
            return
        z_um, curves = zip(*frames.values(), strict=True)
        peaks = tile_peaks(np.array(z_um), np.stack(curves))
        ends = touched_ends(peaks)
        is_blank = self._n_frames[number] is None and peaks.n_in_focus == 0
        if any(ends) and not is_blank:
            self._writer.note_focus_at_end(number, ends)

    def next_round(self, plan: ScanPlan, report: Callable[[str], None]) -> ScanPlan | None:
        """Widen the windows that are too short; return the plan with the legs for them, None if there are none."""
        fields = {field.number: field for field in plan.fields}
        touching = self._writer.focus_at_end
        wider = {
            number: widened(fields[number], self._whole[number], plan.sweep, ends)
            for number, ends in touching.items()
            if number in fields
        }
        wider = {number: field for number, field in wider.items() if field != fields[number]}
        if short := touching.keys() - wider.keys():
            report(
                f"{_named(short)} in focus at an end of the whole sweep: heights beyond it are not measured. Take a "
                "longer sweep, or move it."
            )
        if not wider:
            return None
        report(
            f"{_named(wider)} in focus at an end of the z window, or nowhere in it: taken again with a longer one. "
            "Nothing to do."
        )
        for field in wider.values():
            self._writer.change_window(field)
            self._n_frames[field.number] = field.n_frames
        return replanned(plan, wider, self._limits)


def plan_to_continue(plan: ScanPlan, writer: DatasetWriter, limits: RigLimits) -> ScanPlan:
    """Return the plan of a continued scan; one that follows the focus gets legs for the windows as they are now."""
    if plan.strategy != FOLLOW_FOCUS:
        return plan
    plan = writer.record.plan
    kept = {(shot.field, shot.exposure, shot.k) for shot in writer.kept}
    missing: dict[int, Field] = {
        field.number: field
        for field in plan.fields
        if any(
            (field.number, exposure, k) not in kept
            for exposure in range(len(plan.exposures_us))
            for k in range(plan.sweep.frames_of(field))
        )
    }
    return replanned(plan, missing, limits) if missing else plan


def _named(numbers: Iterable[int]) -> str:
    """Return the subject of a sentence about fields, "Field 3 is" or "Fields 3, 7 are"."""
    ordered = sorted(numbers)
    names = ", ".join(map(str, ordered[:NAMED])) + (f" and {len(ordered) - NAMED} more" if len(ordered) > NAMED else "")
    return f"Field {names} is" if len(ordered) == 1 else f"Fields {names} are"
