"""A dataset whose stitched surface is a made-up patterned wafer with defects on it."""

from __future__ import annotations

from pathlib import Path

from tests.support.datasets.compared_datasets import dataset_of
from tests.support.noisy_wafer import Planted, Wafer, wafer

PLANTED = (Planted("bump", 250.0, 392.0, 30, 8), Planted("pit", 110.0, 110.0, 12, 10))


def patterned_dataset(path: Path) -> Wafer:
    """Three rows of four dies, with a bump and a pit."""
    made = wafer(1, (3, 4), (120, 140), PLANTED)
    dataset_of(path, made.surface, "patterned", "2026-01-01T08:00:00")
    return made
