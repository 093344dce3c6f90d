"""Scan a plan on a virtual rig of 96 x 128 pixels by any state of the program, and end in the third pass.

The README beside it says how it is called; it is no test and is not imported.
"""

import importlib
import os
import signal
import sys
from pathlib import Path

ROWS, COLS, KILLED_AT = 96, 128, 45


def part(*names):
    """Return the first of these attributes that this state of the program has."""
    for name in names:
        module, attribute = name.rsplit(".", 1)
        try:
            return getattr(importlib.import_module(f"wafer_viewer.{module}"), attribute)
        except (ImportError, AttributeError):
            continue
    raise ImportError(names)


def end_with_frame(writer):
    """Make the writer of frames end the process, by SIGKILL, at a frame of the third pass."""
    store = writer.frame

    def frame(self, taken):
        store(self, taken)
        if (self.path / "journal.jsonl").read_bytes().count(b"\n") >= KILLED_AT:
            os.kill(os.getpid(), signal.SIGKILL)

    writer.frame = frame


def main(plan, out):
    end_with_frame(part("store.dataset.writer.DatasetWriter", "store.writer.DatasetWriter"))
    virtual_limits = part("rigs.virtual.rig.virtual_limits")
    rig = part("rigs.virtual.rig.VirtualRig")(limits=virtual_limits(ROWS, COLS), seed=0)
    job = part("model.spec.decode")(Path(plan).read_bytes(), part("model.job.Job", "model.plan.Job"), plan)
    scan_to = part("session.acquisition.headless.scan_to", "session.scan_command.scan_to")
    n_callbacks = scan_to.__code__.co_argcount - 3
    scan_to(Path(out), job, rig, *[lambda *_: None] * n_callbacks)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
