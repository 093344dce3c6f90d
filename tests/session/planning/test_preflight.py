"""The six lines before a scan: when each is fine, when a person must look, and when there is no scan."""

from __future__ import annotations

import pytest

from tests.session.conftest import small_job
from tests.support.datasets.released import MARKS, release_of
from wafer_viewer.model.acquisition.sample import Alignment, Sample
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import CALIBRATION, SETUP, virtual_limits
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.session.planning.preflight import Preflight, preflight, require_passed, stops

LIMITS = virtual_limits(540, 720)


def facts(job=None, **changes):
    job = job or small_job()
    complete = {
        "job": job,
        "plan": plan_of(job, LIMITS),
        "limits": LIMITS,
        "simulated": False,
        "calibration": CALIBRATION,
        "setup": SETUP,
        "free_bytes": 10**12,
        "z_um": 0.0,
        "today": "2026-11-21",
    }
    return Preflight(**{**complete, **changes})


def line(what, now):
    return next(check for check in preflight(now) if check.what == what)


def test_a_plain_scan_is_fine_in_all_six_lines():
    checks = preflight(facts())
    assert [c.what for c in checks] == ["Sample", "Alignment", "Calibration", "Disk", "Clearance", "Light"]
    assert {c.state for c in checks} == {"ok"}
    assert all(c.found.endswith(".") and not c.mend for c in checks)
    require_passed(checks, confirmed=False)


def aligned(residual_um):
    return Alignment(residual_um=residual_um, n_marks=2)


NAMELESS = Sample()
HIGHER = replace(small_job(), z_start_um=8956.0)
MARKED = replace(small_job(), marks=MARKS)


@pytest.mark.parametrize(
    ("what", "changes", "state", "words"),
    [
        ("Sample", {"job": replace(small_job(), sample=NAMELESS)}, "stop", "no name"),
        ("Sample", {"job": replace(small_job(), sample=NAMELESS), "simulated": True}, "ok", "without a name"),
        ("Sample", {"confirmed": False}, "stop", "W1 of lot L1: not confirmed"),
        ("Alignment", {"job": MARKED}, "attention", "Not aligned: 0 of 2 corners marked."),
        ("Alignment", {"job": MARKED, "n_marked": 1}, "attention", "Not aligned: 1 of 2 corners marked."),
        ("Alignment", {"job": replace(MARKED, alignment=aligned(10.0))}, "ok", "residual 10.0 um of 10 um"),
        ("Alignment", {"job": replace(MARKED, alignment=aligned(10.1))}, "stop", "10.1 um of 10 um: too large"),
        ("Calibration", {"calibration": None}, "attention", "no calibration"),
        ("Calibration", {"calibration": replace(CALIBRATION, due="2026-11-20")}, "attention", "due on 2026-11-20"),
        ("Calibration", {"calibration": replace(CALIBRATION, due="2026-11-21", simulated=False)}, "ok", "in 0 days"),
        ("Calibration", {}, "ok", "of the simulation"),
        ("Calibration", {"setup": replace(SETUP, zoom=2.0)}, "attention", "zoom=2.0"),
        ("Disk", {"free_bytes": None}, "attention", "the free space is unknown"),
        ("Disk", {"free_bytes": 540 * 720 * 40 - 1}, "stop", "15.6 MB needed"),
        ("Disk", {"free_bytes": 540 * 720 * 40}, "attention", "little is left"),
        ("Disk", {"free_bytes": 540 * 720 * 50}, "ok", "19.4 MB free"),
        ("Clearance", {"z_um": -5960.4}, "ok", "28.0 mm at the nearest"),
        ("Clearance", {"z_um": -5961.0}, "stop", "too near"),
        ("Clearance", {"job": replace(small_job(), z_start_um=8954.4), "z_um": 9000.0}, "ok", "mm at least"),
        ("Clearance", {"job": HIGHER, "z_um": 9000.0}, "stop", "the safe height 9000"),
        ("Light", {"job": replace(small_job(), light_fraction=0.0)}, "stop", "off"),
        ("Light", {"clipped_fraction": 0.05}, "ok", "5.0 %"),
        ("Light", {"clipped_fraction": 0.051}, "attention", "too bright"),
    ],
)  # fmt: skip
def test_each_line_at_its_limits(what, changes, state, words):
    found = line(what, facts(**changes))
    assert (found.state, words in found.found) == (state, True), found
    assert bool(found.mend) == (state != "ok"), "what is wrong says what mends it, and only that"


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("Sample", lambda job: {"job": job, "simulated": True}),
        ("Alignment", lambda job: {"job": job}),
        ("Calibration", lambda job: {"job": job, "calibration": None}),
    ],
)
def test_a_released_job_can_skip_nothing(what, changes):
    assert line(what, facts(**changes(release_of(MARKED)))).state == "stop"


def test_a_stop_forbids_and_attention_asks():
    with pytest.raises(PlanError, match=r"The scan does not start\. Disk: .* free\. Free some space"):
        require_passed(preflight(facts(free_bytes=1)))
    warned = preflight(facts(clipped_fraction=0.5))
    require_passed(warned)
    with pytest.raises(PlanError, match="Light"):
        require_passed(warned, confirmed=False)
    assert [c.what for c in stops(preflight(facts(free_bytes=1, confirmed=False)))] == ["Sample", "Disk"]


def test_gaps_that_another_objective_leaves_between_the_fields_need_a_person():
    nearer = replace(LIMITS, pixel_um=LIMITS.pixel_um / 2)
    job = replace(small_job(), grid=replace(small_job().grid, cols=2))
    check = line("Objective", facts(job, limits=nearer))
    assert check.state == "attention"
    assert "168 x 126 um" in check.found


@pytest.mark.parametrize(
    ("wish", "setup", "state"),
    [
        ({}, {}, None),
        ({"objective": SETUP.objective}, {}, "ok"),
        ({"zoom": 2.0}, {}, "stop"),
        ({"objective": "50x/0.55"}, {}, "stop"),
        ({}, {"objective": "unknown"}, "stop"),
    ],
)
def test_an_objective_is_checked_where_the_plan_names_one_or_the_rig_does_not_know_it(wish, setup, state):
    checks = preflight(facts(replace(small_job(), **wish), setup=replace(SETUP, **setup)))
    assert [check.state for check in checks[6:]] == ([] if state is None else [state])
