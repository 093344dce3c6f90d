"""What the page does with files, as functions that a struck command calls (tests/support/struck_command.py)."""

from __future__ import annotations

import types
from pathlib import Path
from typing import Any

from wafer_viewer.model.errors import DatasetError


def settings(folder: str) -> None:
    """Remember what is open, as the session does after each change and at its end; the log's warning is the error."""
    from wafer_viewer.session.session_restore import RestorePoint, SessionRestore, log

    warnings = list[str]()
    log.addFilter(lambda record: warnings.append(record.getMessage()))
    restore: Any = SessionRestore(Path(folder))
    restore.claim()
    restore._waiting = RestorePoint(version=1, dataset=f"{folder}/a.wafer")
    restore.write()
    restore.close(types.SimpleNamespace(reopening=True), "default")
    if warnings:
        raise DatasetError(warnings[0])


def upload(folder: str) -> None:
    """Take a file that a browser has sent."""
    from wafer_viewer.gui.page.uploads import UploadFolder

    UploadFolder(Path(folder)).save("surface.npz", bytes(range(256)) * 1000, "upload")
