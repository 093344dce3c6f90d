"""Heights of a field from its window against those from the whole sweep, on a bowed wafer of the virtual rig."""

from __future__ import annotations

import pytest

from tests.bench.bench_follow_focus import SWEEP, fields_of, quality_of
from tests.support.bowed_wafer import BowedWafer
from wafer_viewer.acquire.focus.windows import fields_in_focus
from wafer_viewer.model.acquisition.plan import CoarseLook, FocusCell, FocusPlace, FollowFocus
from wafer_viewer.rigs.virtual.rig import virtual_limits


@pytest.mark.slow
def test_a_window_of_a_quarter_of_the_sweep_gives_the_same_heights():
    limits = virtual_limits(270, 360)
    wafer = BowedWafer(limits, seed=1006)
    fields = fields_of(wafer)
    places = []
    for field in fields[::2]:
        low_um = wafer.form_um(field.x_um, field.y_um) - 1
        cell = FocusCell(field.x_um, field.y_um, low_um, low_um + 32)
        places.append(FocusPlace(field=field.number, x_um=field.x_um, y_um=field.y_um, cells=(cell,), u_um=1.3))
    look = CoarseLook(places=tuple(places), duration_s=20.0)
    windows = fields_in_focus(fields, SWEEP, limits, FollowFocus(), look)
    assert windows[3].n_frames < 40
    whole_rmse_um, whole_kept, settled = quality_of(wafer, fields[3], SWEEP.n_frames)
    rmse_um, kept, _ = quality_of(wafer, windows[3], windows[3].n_frames, settled)
    assert rmse_um < 1.2 * whole_rmse_um
    assert kept > whole_kept - 0.01
