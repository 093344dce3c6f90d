"""Datasets of a folder whose frames may be removed: accepted, old enough by the rule, and not held."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.retention import RetentionRule
from wafer_viewer.session.core.dataset_library import ACCEPTED, ENDING, today, verdict_word
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.retention import RULE, required_rule


@dataclass(frozen=True, slots=True)
class OldFrames:
    """Dataset whose frames may be removed, their size, and the day until which they had to be kept.

    begun: an earlier removal was broken off.
    """

    path: Path
    n_bytes: int
    until: str
    begun: bool


def rule_of(folder: Path, days: int | None) -> RetentionRule:
    """Return the rule of a folder, or one of a number of days. Raises DatasetError where neither says a number."""
    rule = required_rule(folder) if days is None else RetentionRule(frames_days=days)
    if rule.frames_days is None:
        raise DatasetError(
            f"Frames in {folder} are kept for ever: give --days N, or write frames_days = N into {folder / RULE}."
        )
    return rule


def old_frames(folder: Path, rule: RetentionRule) -> tuple[OldFrames, ...]:
    """Return the datasets of a folder whose frames may be removed today, by name."""
    found = (_old(path, rule) for path in sorted(folder.glob(f"*{ENDING}")))
    return tuple(old for old in found if old is not None)


def _old(path: Path, rule: RetentionRule) -> OldFrames | None:
    try:
        data = Dataset.open(path)
    except WaferViewerError:
        return None
    n_bytes = data.frame_bytes()
    if data.held is not None or not data.finished or not n_bytes:
        return None
    until = rule.until(data.scan.taken)
    if data.removed is not None:
        return OldFrames(path, n_bytes, until or "", begun=True)
    if until is None or until > today() or verdict_word(data) != ACCEPTED:
        return None
    return OldFrames(path, n_bytes, until, begun=False)
