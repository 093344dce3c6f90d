"""Run shinestacker on a folder of frames: a program of its own, for it needs a newer Python than we do.

    python tests/bench/peer_shinestacker.py FOLDER RESULT.npz ["depth map" | pyramid]

Its settings are its own; RESULT holds all_in_focus, seconds and, by depth map, frame.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from shinestacker.algorithms.depth_map import DepthMapStack
from shinestacker.algorithms.pyramid import PyramidStack


class Recording(DepthMapStack):
    """Notes the frame of the greatest energy, band by band of rows."""

    def __init__(self, **settings):
        super().__init__(**settings)
        self.best = []

    def get_focus_map(self, energies, quiet=False):
        self.best.append(energies.argmax(axis=0))
        return super().get_focus_map(energies, quiet)


class Nobody:
    """Whatever it reports to."""

    input_path = output_path = name = ""

    def __getattr__(self, name):
        return lambda *_, **__: True


def main(folder: str, result: str, name: str = "depth map") -> None:
    method = PyramidStack() if name == "pyramid" else Recording(max_threads=1)
    method.set_process(Nobody())
    files = [str(file) for file in sorted(Path(folder).glob("frame*.tif"))]
    method.init(files)
    method.total_steps(len(files))
    began = time.perf_counter()
    picture = np.asarray(method.focus_stack())
    seconds = time.perf_counter() - began
    frames = {} if name == "pyramid" else {"frame": np.vstack(method.best)}
    np.savez(result, all_in_focus=picture[..., 0], seconds=seconds, **frames)


if __name__ == "__main__":
    main(*sys.argv[1:])
