"""A real focus stack, photographed elsewhere: it becomes a surface with nothing set by hand.

Runs where the photographs lie beside the checkout; they are too large to be part of it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wafer_viewer as wv
from wafer_viewer.cli.app import main

STACK = Path(__file__).parents[3] / "shared" / "data" / "pcb-stack"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not STACK.is_dir(), reason="the photographs of the circuit board are not on this machine"),
]


def test_a_folder_of_photographs_becomes_a_surface(tmp_path, capsys):
    where = ["--z-step-um", "1", "--pixel-um", "1"]
    assert main(["import", str(STACK), *where, "-o", str(tmp_path / "board.wafer")]) == 0
    assert main(["reconstruct", str(tmp_path / "board.wafer"), "-o", str(tmp_path / "board.npz")]) == 0
    board = wv.read_npz(tmp_path / "board.npz")
    assert board.shape == (1536, 2048)
    assert 0.5 < board.measured.mean() < 0.95
    heights = board.z_um[board.measured]
    assert heights.min() >= 0
    assert heights.max() <= 9
    assert board.provenance.calibration is None
    assert not board.provenance.simulated


@pytest.mark.campaign
def test_odd_and_even_frames_tell_the_same_heights():
    """Two half stacks share no frame: where both measured, they agree within their own, doubled step."""
    complete = wv.open_stack(STACK, z_step_um=1.0, pixel_um=1.0)
    halves = [
        wv.reconstruct(
            wv.FieldStack(
                complete.field, complete.images[first::2], complete.z_um[first::2], complete.present[first::2], 1.0
            )
        )
        for first in (0, 1)
    ]
    apart = np.abs(halves[0].z_raw_um - halves[1].z_raw_um)
    both = np.isfinite(apart)
    assert both.mean() > 0.2
    assert np.mean(apart[both] <= 2.0) > 0.9
