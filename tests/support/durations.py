"""Seconds that the files of the tests took: the longest begin first, since the other worker waits for what is last.

``WAFER_VIEWER_DURATIONS=1 bash tests/run.sh`` renews ``tests/durations.json`` for the files that it ran, on an idle
machine. Files under `LEAST_S` are left out.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Mapping

from tests.support.paths import ROOT

FILE = ROOT / "tests/durations.json"
LEAST_S = 2.0
RENEWS = bool(os.environ.get("WAFER_VIEWER_DURATIONS"))


@functools.cache
def recorded() -> dict[str, float]:
    """Return the seconds by file, under the root of the checkout."""
    return json.loads(FILE.read_text())


def renewed(before: Mapping[str, float], took: Mapping[str, float]) -> dict[str, float]:
    """Return the durations with those of a run in place of older ones, the longest first."""
    there = {file: s for file, s in {**before, **took}.items() if s >= LEAST_S and (ROOT / file).is_file()}
    return {file: round(there[file], 1) for file in sorted(there, key=there.__getitem__, reverse=True)}


def renew(took: Mapping[str, float]) -> None:
    """Write the durations of a run."""
    FILE.write_text(json.dumps(renewed(recorded(), took), indent=2) + "\n")
