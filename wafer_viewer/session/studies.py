"""Studies of the gauge: repeatability and reproducibility from a table of repeated measurements."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.repeatability import GaugeRR, Method


class Studies:
    """Questions, from any thread; they change nothing. All raise WaferViewerError when there is no answer."""

    def gauge_rr(self, path: Path, method: Method = "anova", tolerance_um: float | None = None) -> GaugeRR:
        """How much of the spread of a study, a CSV with part, appraiser and value, is the gauge's."""
        from wafer_viewer.measure.repeatability import gauge_rr
        from wafer_viewer.store.study import read_study

        return gauge_rr(read_study(Path(path).expanduser()), method=method, tolerance=tolerance_um)
