"""Time for which the frames of accepted datasets are kept: the file ``retention.toml`` of a data folder."""

from __future__ import annotations

import datetime
from typing import ClassVar

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Count, Spec


class RetentionRule(Spec, frozen=True, kw_only=True):
    """Setting of a data folder. frames_days: days after a scan until its frames may be removed; None for never."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    frames_days: Count | None = None

    def until(self, taken: str) -> str | None:
        """Return the day until which frames taken at a time (ISO 8601) are kept, ISO 8601; None for ever."""
        if self.frames_days is None:
            return None
        try:
            day = datetime.date.fromisoformat(taken[:10]) + datetime.timedelta(days=self.frames_days)
        except (ValueError, OverflowError):  # an import may carry no date, which is then never old enough
            return None
        return day.isoformat()
