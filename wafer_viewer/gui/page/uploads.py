"""Files that a browser sends to the machine that runs the viewer."""

from __future__ import annotations

import tempfile
from pathlib import Path

import viser


def put_down(file: viser.UploadedFile, otherwise: str = "upload") -> Path:
    """Keep what a browser sent in a folder of its own; only the last part of its name is taken from the sender.

    otherwise: what it is called where the sender gave no name.
    """
    target = Path(tempfile.mkdtemp(prefix="wafer-viewer-")) / (Path(file.name).name or otherwise)
    target.write_bytes(file.content)
    return target
