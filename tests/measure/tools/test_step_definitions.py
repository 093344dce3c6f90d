"""What h is, how faces of several regions are joined, and what the poses of fields do to it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.surfaces import calibration, coordinates, gauge_blocks, noise_of, surface_of
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Conditions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Form, Poses, no_seams, no_shifts
from wafer_viewer.model.surface.height_map import ReadThrough

UPPER, LOWER = Region.rectangle(-150, -50, -40, 50), Region.rectangle(40, -50, 150, 50)
TILT, LEVER_UM = 2e-3, 95.0


@pytest.mark.parametrize(
    ("definition", "height_um"),
    [
        ("joint", 399.88),
        ("lower_face", 399.88 + 190 / 2 * TILT),
        ("upper_face", 399.88 - 190 / 2 * TILT),
        ("common_plane", 399.88),
    ],
)
def test_every_definition_has_its_own_height(definition, height_um):
    """The lower face falls towards the joint, by 2 mrad."""
    step = step_height(gauge_blocks(1, noise_um=0.0, tilt=TILT, level=0.0), UPPER, LOWER, definition=definition)
    assert step.height.value_um == pytest.approx(height_um, abs=2e-3)
    assert step.options.definition == definition
    assert step.at_joint.value_um == pytest.approx(399.88, abs=2e-3)


def test_the_definition_says_how_far_the_others_are_unless_it_is_fixed():
    tilted = gauge_blocks(1, noise_um=0.01, tilt=TILT)
    lines = {
        definition: {
            line.name: line.u_um for line in step_height(tilted, UPPER, LOWER, definition=definition).height.budget
        }
        for definition in ("common_plane", "lower_face")
    }
    assert lines["common_plane"]["levelling"] == pytest.approx(190 * TILT / np.sqrt(12), rel=0.1)
    assert lines["lower_face"]["levelling"] == 0.0


def test_u_reaches_the_height_levelled_to_either_face():
    """The wide lower face levels the common plane: the upper face alone gives a height far from it."""
    narrow = Region.rectangle(-70, -50, -40, 50)
    tilted = gauge_blocks(1, noise_um=0.01, tilt=TILT, u_z_scale=0.0)
    step = step_height(tilted, narrow, LOWER)
    for definition in ("upper_face", "lower_face"):
        other = step_height(tilted, narrow, LOWER, definition=definition).height.value_um
        assert abs(other - step.height.value_um) <= step.height.expanded_um, definition


def padded():
    """A level step of 30 um; the far half of its upper face lies 0.9 um higher, as bond pads do."""
    x_um, _ = np.meshgrid(*coordinates(200, 400))
    z = 30.0 * (x_um < 0) + 0.9 * (x_um < -70)
    return surface_of(z + noise_of(5, z.shape, 0.1, 3), calibration=calibration(u_z_scale=0.0))


@pytest.mark.parametrize("street", [Region.rectangle(40, -45, 60, 45), Region.rectangle(40, -45, 95, 45)])
def test_two_levels_in_a_region_are_in_u_and_named(street):
    step = step_height(padded(), Region.rectangle(-95, -45, -40, 45), street)
    assert 1.0 < abs(step.height.value_um - 30.0) <= step.height.expanded_um, "relief tilts the face, and with it h"
    (note,) = (note for note in step.notes if "levelling" in note)
    assert f"tilted by {step.tilt.value:.1f} mrad against each other" in note
    assert "draw each region on ground of one level" in note
    flat = step_height(padded(), Region.rectangle(-68, -45, -40, 45), street)
    assert abs(flat.height.value_um - 30.0) <= flat.height.expanded_um < 0.5
    assert not [note for note in flat.notes if "levelling" in note]


def u_of(budget, name):
    return {line.name: line.u_um for line in budget}[name]


@pytest.mark.slow
def test_tilt_and_the_step_at_the_joint_have_their_uncertainty():
    found = [step_height(gauge_blocks(s, 0.5, 4.0, u_z_scale=0.0), UPPER, LOWER) for s in range(12)]
    errors = np.array([step.at_joint.value_um - 399.88 for step in found])
    assert np.mean(np.abs(errors) <= [step.at_joint.expanded_um for step in found]) >= 0.8
    assert all(step.tilt.unit == "mrad" and step.tilt.status == "evaluated" for step in found)
    assert np.mean([abs(s.tilt.value - 0.323) <= s.tilt.expanded for s in found]) >= 0.8


def terraced():
    """Four squares, those on the left and on the right 5 um over the two between them, all tilted by 1 mrad."""
    x_um, y_um = np.meshgrid(*coordinates(200, 400))
    z = 5.0 * (np.abs(x_um) > 40) + 1e-3 * (x_um - y_um)
    return surface_of(z + noise_of(5, z.shape, 0.05, 3), calibration=calibration(u_z_scale=0.0))


def test_a_face_may_have_several_regions():
    uppers = Region.rectangle(-90, -40, -50, 40), Region.rectangle(50, -40, 90, 40)
    lowers = [Region.rectangle(-30, -40, 30, -5), Region.rectangle(-30, 5, 30, 40)]
    step = step_height(terraced(), uppers, lowers)
    assert step.height.value_um == pytest.approx(5.0, abs=0.02)
    assert abs(step.height.value_um - 5.0) <= step.height.expanded_um
    assert step.drawn == (uppers[0], lowers[0], uppers[1], lowers[1])
    one_sided = step_height(terraced(), uppers[:1], lowers[0])
    assert step.height.expanded_um < one_sided.height.expanded_um, "faces on both sides tell the tilt"


@pytest.mark.parametrize(
    ("upper", "lower", "sentence"),
    [
        ((), LOWER, "No upper region was given: draw at least one on the upper face"),
        ((500, 1), LOWER, "The upper region is 500: give a Region, as of Region.rectangle"),
        ((UPPER, UPPER), LOWER, "The two regions share"),
        ((UPPER, Region.point(0, 0)), LOWER, "The upper region is a point and has no area"),
        (Region.rectangle(-500, -50, -40, 50), LOWER, "Only 26 % of the upper region is measured and a step height"),
    ],
)  # fmt: skip
def test_regions_that_are_none_are_one_sentence(upper, lower, sentence):
    with pytest.raises(MeasureError, match=sentence):
        step_height(gauge_blocks(1), upper, lower)


class OfFields(ReadThrough):
    """A surface with word of the fields that it was stitched from."""

    def __init__(self, surface, poses):
        self.surface, self.poses = surface, poses

    def window(self, region=None, level=0):
        return self.surface.window(region, level)


def placed(*x_um, seam_u_um=0.05):
    """Fields 200 x 150 um in a row, each against the next as sure as a seam tells."""
    n = len(x_um)
    zeros = np.zeros(n)
    seams = no_seams()
    if n > 1:
        mids = (np.array(x_um[1:]) + x_um[:-1]) / 2
        valid = np.diag([seam_u_um**-2.0, 1e12, 1e12])
        one = np.ones(n - 1)
        seams = dataclasses.replace(
            seams, first=np.arange(n - 1, dtype=np.int32), second=np.arange(1, n, dtype=np.int32), mid_x_um=mids,
            mid_y_um=0 * one, z_um=0 * one, slope_x=0 * one, slope_y=0 * one, information=np.tile(valid, (n - 1, 1, 1)),
            weight=one.astype(np.float32), step_um=0 * one, rms_um=0 * one,
        )  # fmt: skip
    return Poses(
        numbers=np.arange(1, n + 1, dtype=np.int32), marks=np.zeros(n, np.int64), stage_x_um=np.array(x_um),
        stage_y_um=zeros, x_um=np.array(x_um, float), y_um=zeros, z_um=zeros, tilt_x=zeros, tilt_y=zeros,
        u_x_um=zeros, u_y_um=zeros, u_z_um=zeros + 1.0, group=np.zeros(n, np.int32), left_out=np.zeros(n, bool),
        shifts=no_shifts(), seams=seams, form=Form(field_size_um=(200.0, 150.0)), z_error_um=1.0,
    )  # fmt: skip


def pose_line(poses, upper=UPPER, lower=LOWER):
    step = step_height(OfFields(gauge_blocks(1, noise_um=0.1), poses), upper, lower)
    return {line.name: line.u_um for line in step.height.budget}.get("poses of the fields"), step.not_evaluated


def test_regions_of_one_field_have_none_of_its_pose():
    assert pose_line(placed(0.0))[0] == 0.0


def test_regions_of_two_fields_are_as_sure_as_the_seam_between_them():
    near, far = pose_line(placed(-95.0, 95.0))[0], pose_line(placed(-95.0, 95.0, seam_u_um=0.5))[0]
    assert near == pytest.approx(0.05, rel=0.1)
    assert far == pytest.approx(0.5, rel=0.15)


def test_a_chain_of_fields_is_less_sure_than_two():
    """The regions lie in the outer two of three."""
    apart = Region.rectangle(-150, -50, -60, 50), Region.rectangle(60, -50, 150, 50)
    assert pose_line(placed(-95.0, 0.0, 95.0), *apart)[0] == pytest.approx(0.05 * np.sqrt(2), rel=0.15)


def test_where_nobody_knows_the_poses_they_are_not_evaluated():
    line, missing = pose_line(None)
    assert line is None
    assert "poses of the fields" in missing


def test_what_a_calibration_knows_of_the_axis_is_in_the_budget():
    held = replace(calibration(), u_z_linearity_um=0.03, u_abbe_um=0.04)
    blocks = gauge_blocks(1, calibration=held)
    given = step_height(blocks, UPPER, LOWER, conditions=Conditions(abbe_um=0.01))
    lines = {line.name: line.u_um for line in given.height.budget}
    assert (lines["z linearity"], lines["Abbe offset"]) == (0.03, 0.01)
    assert given.not_evaluated == ("drift during the scan", "repeatability", "temperature")
