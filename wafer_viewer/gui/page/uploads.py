"""Files uploaded by a browser to the computer that runs the viewer."""

from __future__ import annotations

import tempfile
from pathlib import Path

import viser


def save_upload(file: viser.UploadedFile, otherwise: str = "upload") -> Path:
    """Save an upload in a new temporary folder; of the sender's path only the file name is used.

    otherwise: file name if the sender gave none.
    """
    target = Path(tempfile.mkdtemp(prefix="wafer-viewer-")) / (Path(file.name).name or otherwise)
    target.write_bytes(file.content)
    return target
