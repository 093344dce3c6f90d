"""The benchmark of stitching, which calls the steps of stitching one by one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[1] / "bench" / "bench_stitch.py"


@pytest.mark.campaign
def test_it_places_a_small_grid_and_names_its_costs(tmp_path: Path) -> None:
    command = (sys.executable, str(BENCH), "--quick", "--only", "positions", "costs")
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "TMPDIR": str(tmp_path)})
    assert done.returncode == 0, done.stderr
    rule = next(line for line in done.stdout.splitlines() if line.strip().startswith("as a rule"))
    assert float(rule.split()[3]) < 0.2, "rms error of the positions, px"
    assert "blend, pyramid and store" in done.stdout
