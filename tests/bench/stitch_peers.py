"""Other people's stitchers beside ours, on the same tiles: where they lay them, how long they take.

They run in an environment of their own: WAFER_VIEWER_STITCHERS_PYTHON names its Python, in which was said

    pip install m2stitch ashlar multiview-stitcher opencv-python-headless scikit-image

What took them minutes is kept in the temp folder, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bench import peer_stitchers
from tests.bench.stitch_judge import Positions, position_error
from tests.truth.field_grid import HOME, PIXEL_UM, Made

PYTHON = os.environ.get("WAFER_VIEWER_STITCHERS_PYTHON", sys.executable)
MODULES = {
    "m2stitch": "m2stitch",
    "ashlar": "ashlar.reg",
    "multiview-stitcher": "multiview_stitcher",
    "scikit-image": "skimage",
    "opencv": "cv2",
    "multiview-stitcher fuse": "multiview_stitcher",
    "opencv feather": "cv2",
}
TITLES = {"scikit-image": "scikit-image, least squares", "opencv": "OpenCV phaseCorrelate, least squares"}
QUICK = ("scikit-image", "opencv")
PLACERS, SPLICERS = tuple(peer_stitchers.PLACING), tuple(peer_stitchers.SPLICING)


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a program put the tiles; seconds by the clock and of the processor; None where it is missing or gave up."""

    found: Positions | None
    seconds: float | None
    processor_s: float | None
    why_not: str = ""


def place(name: str, made: Made) -> Placed:
    """What a program for placing makes of a grid."""
    told = run(name, made)
    if isinstance(told, str):
        return Placed(None, None, None, told)
    x_um, y_um = told["left_px"] * PIXEL_UM, -told["top_px"] * PIXEL_UM
    return Placed(position_error(x_um, y_um, made), float(told["seconds"]), float(told["processor_s"]))


def splice_s(name: str, made: Made) -> tuple[float, float] | str:
    """Seconds (clock, processor) to make one height map of the tiles where the stage has them, or why it cannot."""
    told = run(name, made)
    return told if isinstance(told, str) else (float(told["seconds"]), float(told["processor_s"]))


def run(name: str, made: Made) -> dict[str, NDArray] | str:
    """What a program found, now or in an earlier run; a sentence where it cannot."""
    kept = HOME / "peers" / f"{made.known.grid.name} {name}.npz"
    if not kept.exists():
        if not is_there(name):
            return f"no {MODULES[name].split('.')[0]}: see the head of {Path(__file__).name}"
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            result = Path(folder) / "result.npz"
            np.savez(Path(folder) / "job.npz", **job(made))
            command = [PYTHON, peer_stitchers.__file__, name, str(Path(folder) / "job.npz"), str(result)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                return f"gave up: {done.stderr.strip().splitlines()[-1][:60]}"
            shutil.move(result, kept)
    with np.load(kept) as members:
        return dict(members)


def is_there(name: str) -> bool:
    look = [PYTHON, "-c", f"import {MODULES[name]}"]
    return subprocess.run(look, capture_output=True, check=False).returncode == 0


def job(made: Made) -> dict[str, NDArray]:
    """The tiles as `peer_stitchers` wants them told."""
    return {
        "files": np.array([str(f) for f in made.files]),
        "row": np.array([f.row for f in made.fields]),
        "col": np.array([f.col for f in made.fields]),
        "top_px": (made.stage_y_um.max() - made.stage_y_um) / PIXEL_UM,
        "left_px": (made.stage_x_um - made.stage_x_um.min()) / PIXEL_UM,
        "edges": made.known.grid.edges,
    }
