"""Search for the focus on the virtual rig: found from several starts, refused with its reason, limits kept."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.focus.search import GoToFocus, parabola_vertex
from wafer_viewer.model.errors import MotionStopped, RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits


class Control:
    def __init__(self, stop_after=10**9):
        self.steps, self._stop_after = [], stop_after

    def should_stop(self):
        return len(self.steps) >= self._stop_after

    def report(self, step):
        self.steps.append(step)


def small_rig(scene, seed=0, **limits):
    return VirtualRig(scene=scene, seed=seed, limits=replace(virtual_limits(270, 360), **limits))


def place(rig, x_um, y_um, z_um):
    rig.stage.move_to(x_um=x_um, y_um=y_um, z_um=z_um)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x_um", "y_um", "off_um", "seed"),
    [(0.0, 0.0, 0.0, 1), (500.0, -300.0, 35.0, 2), (-700.0, 250.0, -48.0, 3), (120.0, 640.0, 150.0, 4)],
)
def test_the_focus_of_a_flat_sample_is_found_within_a_fraction_of_the_depth_of_field(x_um, y_um, off_um, seed):
    rig = small_rig("plane", seed)
    truth_um = float(rig.truth_for_tests(x_um, y_um))
    place(rig, x_um, y_um, truth_um + off_um)
    found = GoToFocus(exposure_us=100.0).run(rig, control := Control())
    assert found.z_um == pytest.approx(truth_um, abs=rig.limits.depth_of_field_um / 10)
    assert 0.0 < found.u_um < rig.limits.depth_of_field_um / 10
    assert rig.stage.position().z_um == pytest.approx(found.z_um, abs=0.02)
    assert not rig.stage.moving()
    assert 0.0 < control.steps[-1].fraction <= 1.0


def test_the_focus_stays_clear_of_the_highest_known_point():
    rig = small_rig("plane")
    objective = rig.limits.objective
    free_um = objective.working_distance_um - objective.clearance_um
    truth_um = float(rig.truth_for_tests(0.0, 0.0))
    place(rig, 0.0, 0.0, truth_um + 30.0)
    with pytest.raises(RigError, match=r"where z stops|Nothing is in focus"):
        GoToFocus(exposure_us=100.0, highest_um=truth_um + 15.0 + free_um).run(rig, Control())
    assert rig.stage.position().z_um == pytest.approx(truth_um + 30.0, abs=0.02)


@pytest.mark.slow
def test_nothing_in_focus_is_refused_with_what_to_do_and_the_stage_back_at_its_start():
    rig = small_rig("plane")
    place(rig, 0.0, 0.0, 2_000.0)
    with pytest.raises(RigError, match=r"Nothing is in focus from z 1\d+\.\d to 2\d+\.\d um: .* Move to a place with"):
        GoToFocus(exposure_us=100.0).run(rig, Control())
    assert rig.stage.position().z_um == pytest.approx(2_000.0, abs=0.02)


def test_a_stopped_search_leaves_the_rig_at_rest():
    rig = small_rig("plane")
    with pytest.raises(MotionStopped):
        GoToFocus(exposure_us=100.0).run(rig, Control(stop_after=3))
    assert not rig.stage.moving()


def test_the_uncertainty_of_the_vertex_is_the_scatter_of_repeated_fits():
    rng, z_um = np.random.default_rng(11), np.linspace(-4.0, 6.0, 21)
    curve = 1.0 + 0.02 * (z_um - 0.7) ** 2
    fits = [parabola_vertex(z_um, curve + rng.normal(0.0, 0.01, z_um.size)) for _ in range(400)]
    at_um, u_um = np.array(fits).T
    assert at_um.mean() == pytest.approx(0.7, abs=3 * at_um.std() / 20)
    assert u_um.mean() == pytest.approx(at_um.std(), rel=0.15)
    assert parabola_vertex(z_um, -curve) is None
