"""Gaps of a stack: heights beside them are told to be less certain, and are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.truth.phase import Stairs, Tilted, stairs
from wafer_viewer.measure.base.measurement_context import GAPS, frame_lines_um
from wafer_viewer.model.surface.frame_health import FrameHealth
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.blending.stitched_mosaic import mosaic_provenance
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess.frame_jitter import FrameGap, add_gaps, frame_gaps, worst_gap_u_um


@pytest.fixture(scope="module")
def seen() -> Stairs:
    return stairs(Tilted(step_dof=0.6, contrast=0.2, seed=1003, shape=(64, 384)))


def without(seen: Stairs, *slots: int) -> HeightMap:
    present = np.ones(len(seen.stack.z_um), bool)
    present[list(slots)] = False
    return reconstruct(dataclasses.replace(seen.stack, present=present), threads=1)


def test_heights_beside_a_missing_frame_are_off_by_what_is_told(seen: Stairs):
    middle = len(seen.stack.z_um) // 2
    whole, surface = without(seen), without(seen, middle)
    assert whole.provenance.frame_health.u_gap_um == 0
    told_um = surface.provenance.frame_health.u_gap_um
    middle_um = seen.stack.z_um[middle]
    (gap,) = frame_gaps(np.delete(seen.stack.z_um, middle), seen.stack.depth_of_field_um)
    assert gap.low_um < middle_um < gap.high_um
    off_um = (surface.z_raw_um - seen.truth_um)[16:-16, gap.concerns(seen.truth_um)]
    of_columns = np.nanmedian(off_um, axis=0)
    rms_um = float(np.sqrt(np.mean(of_columns**2)))
    assert rms_um == pytest.approx(told_um, rel=0.4)  # before, nothing told it
    assert np.abs(of_columns).max() > 5 * np.abs(np.nanmedian((whole.z_raw_um - seen.truth_um)[16:-16], axis=0)).mean()
    assert frame_lines_um(surface.provenance)[GAPS] == pytest.approx(2**0.5 * told_um)
    assert GAPS not in frame_lines_um(whole.provenance)


def test_heights_far_from_the_gap_are_as_sure_as_before(seen: Stairs):
    middle = len(seen.stack.z_um) // 2
    whole, surface = without(seen), without(seen, middle)
    assert whole.u_um is not None
    assert surface.u_um is not None
    (gap,) = frame_gaps(np.delete(seen.stack.z_um, middle), seen.stack.depth_of_field_um)
    near = gap.concerns(seen.truth_um)
    assert near.any()
    assert not near.all()
    inner = (slice(8, -8), slice(8, -8))
    near = np.broadcast_to(near, whole.z_raw_um.shape)[inner]
    more = np.sqrt(np.maximum(surface.u_um[inner] ** 2 - whole.u_um[inner] ** 2, 0))
    assert np.nanmedian(more[near]) == pytest.approx(gap.u_um, rel=0.2)
    assert np.nanmedian(more[~near]) < 0.25 * gap.u_um


def test_a_gap_where_nothing_was_measured_does_not_count(seen: Stairs):
    surface = without(seen, 3)
    assert surface.provenance.frame_health.u_gap_um == 0
    assert worst_gap_u_um((FrameGap(0.0, 1.0, 0.5),), np.full((4, 4), np.nan, np.float32)) == 0
    assert worst_gap_u_um((FrameGap(0.0, 1.0, 0.5), FrameGap(0.5, 2.0, 0.7)), np.ones((4, 4), np.float32)) == 0.7


def test_even_and_slightly_uneven_frames_have_no_gap():
    z_um = np.arange(20.0) + 0.2 * np.sin(np.arange(20.0))
    assert frame_gaps(z_um, 2.0) == ()
    one, two = (frame_gaps(np.delete(np.arange(20.0), out), 2.0)[0] for out in ([7], [7, 8]))
    assert (one.low_um, one.high_um) == (4.5, 9.5)
    assert two.u_um > 2 * one.u_um


def test_uncertainties_without_a_gap_are_left_alone():
    u_um, z_um = np.array([[0.3, np.nan]], np.float32), np.array([[1.0, np.nan]], np.float32)
    assert add_gaps(u_um, z_um, ()) is u_um
    assert add_gaps(u_um, z_um, (FrameGap(0.0, 2.0, 0.4),))[0, 0] == pytest.approx(0.5)


def test_a_mosaic_has_the_worst_gap_of_its_fields():
    parts = [Provenance(frame_health=FrameHealth(u_gap_um=gap_um)) for gap_um in (0.0, 0.2, 0.1)]
    assert mosaic_provenance(parts, Recipe()).frame_health == FrameHealth(u_gap_um=0.2)
