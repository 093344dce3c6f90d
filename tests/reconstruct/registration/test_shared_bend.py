"""Bends that all overlaps share do not count against them, and a distorting lens is named and taken off."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.truth.drawn_grids import PIXEL_UM, MadeGrid, drawn, made
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Poses, RejectionReason
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.stitching import stitch

TILES = {"kind": "random", "rows": 4, "cols": 4, "shape": (200, 260), "overlap": 0.14, "stage_px": 1.5, "noise": 2.0}
TILES |= {"backlash_px": 0.0, "drift_px": 0.0, "turn": 0.0, "scale": 0.0, "blank": 0.0, "dust": 0.0, "missing": ()}
TILES |= {"misfits": ()}


def grid(seed: int, **changes: object) -> MadeGrid:
    return made(dataclasses.replace(drawn(seed), **(TILES | changes)))


def off_px(poses: Poses, tiles: MadeGrid) -> float:
    """Return the rms error of the places, apart from that of the whole, in pixels."""
    off = (np.column_stack((poses.x_um, poses.y_um)) - tiles.true_um)[~poses.left_out] / PIXEL_UM
    return float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)))


@pytest.mark.slow
def test_overlaps_that_are_bent_alike_are_believed():
    tiles = grid(1000, distortion=0.008, lens_at=(0.0, 0.8))
    poses = stitch(tiles.heights).poses
    assert poses.shifts.believed.all()
    (note,) = (note for note in poses.notes if "distorts" in note)
    assert re.search(r"overlaps are bent alike, by [\d.]+ px at their ends", note)


@pytest.mark.slow
def test_foreign_field_is_left_out_though_overlaps_are_bent():
    tiles = grid(1001, distortion=0.008, lens_at=(0.0, 0.8), misfits=((5, "foreign"),))
    poses = stitch(tiles.heights).poses
    assert np.flatnonzero(poses.left_out).tolist() == [5]
    at_foreign = (poses.shifts.first == 5) | (poses.shifts.second == 5)
    assert (poses.shifts.doubt[~at_foreign] == RejectionReason.NONE).all()


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("distortion", [0.004, -0.004])
def test_distortion_of_the_lens_does_not_move_fields(distortion):
    tiles = grid(1002, distortion=distortion)
    poses = stitch(tiles.heights).poses
    assert off_px(poses, tiles) < 0.1
    (note,) = poses.notes
    told, px = map(float, re.search(r"corners of a field lie ([\d.]+) % \(([\d.]+) px\)", note).groups())
    assert told == pytest.approx(0.4, abs=0.05)
    assert px == pytest.approx(0.004 * np.hypot(100, 130), rel=0.15)
    assert ("out" if distortion > 0 else "in") in note
    straight = stitch(grid(1002).heights).poses
    assert not straight.notes
    assert off_px(straight, grid(1002)) < 0.02


@pytest.mark.slow
def test_pattern_under_a_distorting_lens_is_told():
    tiles = grid(1003, distortion=0.004, kind="dies", pitch_px=(20.0, 20.0), angle=0.0)
    poses = stitch(tiles.heights).poses
    assert off_px(poses, tiles) < 0.1
    assert poses.notes[0].startswith("The lens or the scan distorts: corners of a field lie 0.")


def test_few_overlaps_that_bend_alike_by_chance_are_no_distortion():
    tiles = grid(22035, rows=3, cols=3, shape=(160, 220), stage_px=drawn(22035).stage_px, noise=drawn(22035).noise)
    poses = stitch(tiles.heights).poses
    assert not poses.notes
    assert off_px(poses, tiles) < 0.03


@pytest.mark.slow
def test_calibrated_pixel_size_holds_what_borders_show_of_a_distortion():
    tiles = grid(1004, distortion=0.004, rows=6, cols=6, stage_px=0.5)
    poses = stitch(calibrated(tiles)).poses
    (note,) = poses.notes
    assert "The lens or the scan distorts" in note
    assert off_px(poses, tiles) < 0.1


def calibrated(tiles: MadeGrid) -> list[HeightMap]:
    """Return the fields with the pixel size that borders of fields 3/4 of a field apart show, mean of x and y."""
    sides = np.array(tiles.drawn.shape)
    k = tiles.drawn.distortion / (np.sum((sides - 1) ** 2) / 4)
    square = ((0.75 * sides) ** 2 + (0.25 * sides) ** 2) / 4 + sides[::-1] ** 2 / 12  # of m and d, see shared_bend.py
    pixel_um = float(PIXEL_UM / (1 + k * square.mean()))
    dates = {"made": "2026-03-01", "due": "2027-03-01", "against": "the stage"}
    known = Calibration(pixel_um=pixel_um, u_pixel_um=3e-5 * pixel_um, u_z_scale=1e-3, **dates)
    up, right = (sides - 1) / 2 * (PIXEL_UM - pixel_um)
    return [
        dataclasses.replace(
            height,
            pixel_um=pixel_um,
            x0_um=height.x0_um + right,
            y0_um=height.y0_um - up,
            provenance=replace(height.provenance, calibration=known),
        )
        for height in tiles.heights
    ]
