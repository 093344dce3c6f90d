"""The setting of a data folder that says how long frames are kept."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.retention import RetentionRule
from wafer_viewer.model.spec import decode
from wafer_viewer.store.io.guarded_reading import read_content

RULE = "retention.toml"


def read_rule(folder: Path) -> RetentionRule:
    """Return the setting of a data folder; frames are kept for ever without one, and if it cannot be read."""
    try:
        return required_rule(folder)
    except DatasetError:
        return RetentionRule()


def required_rule(folder: Path) -> RetentionRule:
    """Return the setting of a data folder, the default without one. Raises DatasetError when it cannot be read."""
    path = folder / RULE
    return decode(read_content(path), RetentionRule, path.name) if path.is_file() else RetentionRule()
