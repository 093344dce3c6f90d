"""Run shinestacker's depth map on a folder of frames: a program of its own, for it needs a newer Python than we do.

    python tests/bench/peer_shinestacker.py FOLDER RESULT.npz

Its settings are its own; RESULT holds frame, all_in_focus and seconds.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from shinestacker.algorithms.depth_map import DepthMapStack


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


def main(folder: str, result: str) -> None:
    method = Recording(max_threads=1)
    method.set_process(Nobody())
    method.init([str(file) for file in sorted(Path(folder).glob("frame*.tif"))])
    began = time.perf_counter()
    picture = np.asarray(method.focus_stack())
    np.savez(result, frame=np.vstack(method.best), all_in_focus=picture[..., 0], seconds=time.perf_counter() - began)


if __name__ == "__main__":
    main(*sys.argv[1:])
