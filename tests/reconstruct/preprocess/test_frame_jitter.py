"""z jitter of single frames, seen in the frames: on level faces too, where heights cannot show it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.truth.smooth_scenes import Optics, stack_of
from wafer_viewer.measure.base.measurement_context import Z_JITTER, frame_lines_um
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.frame_health import jitter_u_um
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess.frame_jitter import DIFFERS, FrameJitter, block_means, frame_jitter
from wafer_viewer.reconstruct.preprocess.frames import prepare

PIXEL_UM = 0.5
STILL = Optics(na=0.3, step_dof=0.45, contrast=0.12, full_well_e=15_000.0)


def two_faces(optics: Optics, seed: int) -> FieldStack:
    z_um = np.where(np.arange(224) < 112, 0.0, 25.0) + np.zeros((160, 1))
    return stack_of(z_um, optics, np.random.default_rng(seed), PIXEL_UM)


def found_in(stack: FieldStack) -> FrameJitter:
    frames = prepare(stack)
    return frame_jitter(block_means(frames, stack.depth_of_field_um), frames.z_um, frames.step_um)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("jitter_dof", [0.03, 0.06])
def test_level_faces_show_the_jitter_of_their_frames(jitter_dof: float):
    found = [found_in(two_faces(dataclasses.replace(STILL, jitter_dof=jitter_dof), seed)) for seed in range(8)]
    true_um = jitter_dof * STILL.depth_of_field_um
    assert float(np.median([one.sigma_um for one in found])) == pytest.approx(true_um, rel=0.3)
    assert all(one.widened_um > one.sigma_um for one in found)  # a few frames tell it


@pytest.mark.parametrize("step_dof", [0.25, 0.45, 0.8])
@pytest.mark.parametrize("flicker", [0.0, 0.03])
def test_sharp_frames_show_none(step_dof: float, flicker: float):
    stack = two_faces(dataclasses.replace(STILL, step_dof=step_dof, flicker=flicker), 1001)
    assert found_in(stack).sigma_um < 0.02 * stack.z_step_um


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("step_dof", [0.6, 0.8, 0.9])
def test_rays_that_few_frames_see_show_none(step_dof: float):
    """A lens of rays is sharp in a single frame of a coarse sweep: no jitter, but curves of about one step."""
    optics = dataclasses.replace(STILL, step_dof=step_dof, contrast=0.25, lens="rays")
    found = [found_in(two_faces(optics, seed)).sigma_um / optics.step_um for seed in range(1010, 1016)]
    assert max(found) < 0.02
    assert np.mean(np.array(found) > 0) < 0.2


def test_known_places_of_the_frames_are_no_jitter():
    jittering = two_faces(dataclasses.replace(STILL, jitter_dof=0.06), 3)
    assert found_in(jittering).sigma_um > 0
    rng = np.random.default_rng(3)
    stack = two_faces(STILL, 3)
    step_um = stack.z_step_um
    off_um = 0.06 * STILL.depth_of_field_um * rng.standard_normal(len(stack.z_um))
    told = dataclasses.replace(stack, z_um=stack.z_um + off_um)
    assert found_in(told).sigma_um > 0.05 * step_um  # the frames lie even, but are said to lie elsewhere
    assert found_in(stack).sigma_um < 0.02 * step_um


def test_a_gap_in_the_stack_is_no_jitter():
    stack = two_faces(STILL, 1002)
    present = np.ones(len(stack.z_um), bool)
    present[len(present) // 3] = False
    assert found_in(dataclasses.replace(stack, present=present)).sigma_um < 0.02 * stack.z_step_um


def test_the_difference_of_a_frame_from_those_beside_it_ignores_what_does_not_change():
    assert DIFFERS.sum() == pytest.approx(0.0, abs=1e-7)
    slow = np.exp(2j * np.pi * np.outer(np.arange(-3, 4), np.linspace(0, 0.2, 50)))
    assert np.abs(DIFFERS @ slow).max() < 0.05


def test_few_frames_show_none():
    stack = two_faces(dataclasses.replace(STILL, jitter_dof=0.06), 4)
    few = slice(0, 8)
    short = dataclasses.replace(stack, images=stack.images[few], z_um=stack.z_um[few], present=stack.present[few])
    assert found_in(short).sigma_um == 0


def test_jitter_is_told_and_in_the_budget_of_heights():
    optics = dataclasses.replace(STILL, jitter_dof=0.06)
    surface = reconstruct(two_faces(optics, 2), threads=1)
    single_um, step_um = 0.06 * optics.depth_of_field_um, optics.step_dof * optics.depth_of_field_um
    line_um = frame_lines_um(surface.provenance)[Z_JITTER]
    assert line_um > 2**0.5 * jitter_u_um(single_um, step_um, optics.depth_of_field_um + PIXEL_UM / optics.na) / 1.5
    assert any("jitters by" in note for note in surface.provenance.notes)
    assert surface.u_um is not None
    assert float(np.nanmin(surface.u_um)) > 0.7 * line_um
