"""Gauge R&R from repeat scans at the prompt: six tiny datasets, and what makes no study of them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from tests.support.datasets.judged_datasets import STEP, judged_dataset, released_job
from wafer_viewer.cli.app import main
from wafer_viewer.measure.gauge.gauge_studies import gauge_rr, repeats_of
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.session.gauge.repeat_scans import studies_of

HEIGHTS_UM = {"W1": (11.90, 11.93, 11.91), "W2": (12.30, 12.28, 12.33)}


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Two wafers, three scans of each, by one operator; their names say nothing of their order."""
    folder = tmp_path_factory.mktemp("repeats")
    for wafer, heights_um in HEIGHTS_UM.items():
        for trial, height_um in enumerate(heights_um):
            path = folder / f"{wafer}-{'cab'[trial]}.wafer"
            taken = f"2026-03-0{trial + 1}T10:00:00"
            judged_dataset(path, height_um, released_job(), wafer=wafer, operator="K. Adler", taken=taken, seed=trial)
    return folder


def rr(capsys, *words):
    status = main(["measure", "rr", *(str(word) for word in words)])
    printed = capsys.readouterr()
    return status, json.loads(printed.out) if status == 0 else printed.err


@pytest.mark.slow
def test_scans_of_wafers_are_trials_of_parts_in_order_of_time(scans, capsys):
    status, (study,) = rr(capsys, scans)
    assert status == 0
    assert (study["feature"], study["unit"], study["tolerance"]) == ("die over street", "um", 2.0)
    assert (study["parts"], study["appraisers"]) == (["W1", "W2"], ["K. Adler"])
    expected = np.array([[HEIGHTS_UM["W1"]], [HEIGHTS_UM["W2"]]])
    assert study["values"] == pytest.approx(expected, abs=0.01)
    found = study["found"]
    assert (found["method"], found["parts"], found["appraisers"], found["trials"]) == ("anova", 2, 1, 3)
    assert found["gauge_rr"] == pytest.approx(gauge_rr(expected, tolerance=2.0).gauge_rr, abs=0.005)
    assert found["notes"] == ["One appraiser: reproducibility is not evaluated."]
    _, (by_range,) = rr(capsys, scans, "--method", "range", "--tolerance", 1)
    assert by_range["found"]["share_of_tolerance"] == pytest.approx(6 * by_range["found"]["gauge_rr"])


def test_a_job_of_other_places_is_measured_now(scans, capsys, tmp_path):
    other = replace(STEP, name="street", tool="flatness", places=(Region.rectangle(10, -30, 50, 30),))
    (tmp_path / "job.toml").write_text(encode(released_job(STEP, other)))
    _, studies = rr(capsys, scans, "--job", tmp_path / "job.toml")
    assert [study["feature"] for study in studies] == ["die over street", "street"]
    assert studies[1]["values"][0][0][0] > 0


def test_how_well_a_feature_repeats_is_a_line_for_budgets(scans):
    (study,) = studies_of([scans])
    found = repeats_of(study)
    expected = np.sqrt(np.mean([np.var(heights_um, ddof=1) for heights_um in HEIGHTS_UM.values()]))
    assert (found.degrees_of_freedom, found.unit) == (4, "um")
    assert found.s == pytest.approx(expected, abs=0.005)
    assert found.u_of_mean(4) == pytest.approx(found.s / 2)


def test_a_study_that_is_not_balanced_is_refused_in_one_sentence(scans, capsys):
    five = sorted(scans.glob("*.wafer"))[1:]
    status, printed = rr(capsys, *five)
    assert status == 2
    assert "part W1 has 2 scans by K. Adler where others have 3" in printed
    status, printed = rr(capsys, *five[2:])
    assert (status, printed.count("\n")) == (2, 1)
    assert "two parts" in printed


def test_a_feature_that_one_scan_does_not_show_is_named_with_its_dataset(scans, capsys, tmp_path):
    away = replace(STEP, places=(Region.rectangle(500, 0, 540, 40), STEP.places[1]))
    (tmp_path / "job.toml").write_text(encode(released_job(away)))
    status, printed = rr(capsys, scans, "--job", tmp_path / "job.toml")
    assert status == 2
    assert "'die over street' was not measured in W1-c.wafer." in printed


def test_a_scan_without_a_wafers_id_is_no_part(scans, capsys, tmp_path):
    judged_dataset(tmp_path / "lost.wafer", 12.0, released_job(), wafer="")
    status, printed = rr(capsys, scans, tmp_path)
    assert status == 2
    assert "lost.wafer names no wafer" in printed
    shutil.rmtree(tmp_path / "lost.wafer")
