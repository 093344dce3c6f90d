"""Bends that all overlaps share do not count against them, and a distorting lens is named and taken off."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.truth.drawn_grids import PIXEL_UM, MadeGrid, drawn, made
from wafer_viewer.model.surface.field_poses import Poses, RejectionReason
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


def test_overlaps_that_are_bent_alike_are_believed():
    tiles = grid(1000, distortion=0.008, lens_at=(0.0, 0.8))
    poses = stitch(tiles.heights).poses
    assert poses.shifts.believed.all()
    (note,) = (note for note in poses.notes if "distorts" in note)
    assert re.search(r"all overlaps are bent alike, by [\d.]+ px at their ends", note)


def test_foreign_field_is_left_out_though_overlaps_are_bent():
    tiles = grid(1001, distortion=0.008, lens_at=(0.0, 0.8), misfits=((5, "foreign"),))
    poses = stitch(tiles.heights).poses
    assert np.flatnonzero(poses.left_out).tolist() == [5]
    at_foreign = (poses.shifts.first == 5) | (poses.shifts.second == 5)
    assert (poses.shifts.doubt[~at_foreign] == RejectionReason.NONE).all()


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
