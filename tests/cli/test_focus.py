"""The focus from the command line: z with U at a place; Ctrl-C leaves the rig at rest."""

from __future__ import annotations

import json
import signal

from wafer_viewer.cli.app import main
from wafer_viewer.session.acquisition import headless

PLACE = ("--x-um", "0", "--y-um", "0", "--z-um", "30")


def test_the_focus_is_printed_with_its_uncertainty_and_place(capsys):
    assert main(["focus", *PLACE, "--z-range-um", "24", "--exposure-us", "100", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert abs(found["focus"]["z_um"] - 30.2) < 0.5
    assert 0 < found["focus"]["u_um"] < 0.3
    assert (found["x_um"], found["exposure_us"]) == (0.0, 100.0)


def test_ctrl_c_ends_the_search_with_the_rig_at_rest(capsys, monkeypatch):
    monkeypatch.setattr(headless.ProcedureSteering, "report", lambda *_: signal.raise_signal(signal.SIGINT))
    assert main(["focus", *PLACE, "--exposure-us", "100"]) == 130
    assert "The rig is at rest." in capsys.readouterr().out
