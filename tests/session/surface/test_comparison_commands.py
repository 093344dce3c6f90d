"""Differences that are kept with a dataset: whole or not at all, and opened as any surface."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.compared_datasets import BUMP_UM, SHIFT_UM, two_datasets
from wafer_viewer.model.errors import ComputeError, DatasetError, WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.comparison import ComparisonFace, SurfaceName, show_of
from wafer_viewer.session.session import Session
from wafer_viewer.session.surface.comparison_job import comparison_view, open_surface, subtract
from wafer_viewer.store.dataset.dataset import Dataset

NAME = "difference-after"


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    return two_datasets(tmp_path_factory.mktemp("compared"))


@pytest.fixture(scope="module")
def names(pair):
    return tuple(SurfaceName(path=str(path)) for path in pair)


@pytest.fixture(scope="module")
def stored(pair, names):
    reported: list[float] = []
    comparison = subtract(pair[0], NAME, *names, "auto", False, progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(1.0)
    return comparison


@pytest.mark.slow
def test_a_difference_is_a_result_with_a_mosaic_of_its_own(pair, stored):
    data = Dataset.open(pair[0])
    assert (data.results(), data.differences()) == (("default",), (NAME,))
    assert data.result(NAME).comparison() == stored
    found = stored.registration
    assert (found.x_um, found.y_um) == pytest.approx(SHIFT_UM, abs=found.u_xy_um)
    assert stored.change.gained_um3 - stored.change.lost_um3 == pytest.approx(40 * 60 * BUMP_UM, rel=0.05)
    assert stored.simulated
    off = data.result(NAME).mosaic()
    assert off.levels > 1
    complete = off.window()
    assert int(np.isfinite(complete.z_raw_um).sum()) == stored.change.n_points
    assert stored.change.mean_um == pytest.approx(float(np.nanmean(complete.z_raw_um)), abs=1e-4)
    assert off.provenance.notes[0] == "after minus before."


@pytest.mark.slow
def test_every_face_of_a_comparison_lies_on_the_lattice_of_the_first(pair, stored):
    first, second, difference = (
        comparison_view(pair[0], NAME, f)
        for f in (ComparisonFace.FIRST, ComparisonFace.SECOND, ComparisonFace.DIFFERENCE)
    )
    assert first.shape == second.shape == difference.shape
    place = Region.rectangle(250, 400, 350, 500)
    one, other, off = (s.window(place) for s in (first, second, difference))
    assert np.nanmax(np.abs(other.z_um - one.z_um - off.z_um)) < 1e-4
    both = comparison_view(pair[0], NAME, ComparisonFace.BESIDE)
    for level in (0, both.levels - 1):
        part, alone = both.window(None, level), first.window(None, level)
        rows, cols = alone.shape
        assert np.array_equal(part.z_um[:rows, :cols], alone.z_um, equal_nan=True)
        right = part.z_um[:rows, both.offset // 2**level :][:, :cols]
        assert np.array_equal(right, second.window(None, level).z_um[:rows, : right.shape[1]], equal_nan=True)


@pytest.mark.slow
def test_raw_and_cleaned_heights_of_one_surface(pair, names):
    raw, cleaned = (SurfaceName(path=names[0].path, heights=h) for h in ("raw", "cleaned"))
    made = subtract(pair[1], "difference-cleaned", raw, cleaned, "auto", False)
    assert made.registration.by == "same"
    z = open_surface(names[0]).window()
    assert made.change.sq_um == pytest.approx(float(np.nanstd(z.z_um - z.z_raw_um)), abs=1e-3)
    assert made.change.n_points == np.isfinite(z.z_um - z.z_raw_um).sum()


@pytest.mark.slow
@pytest.mark.parametrize("requested", [1, 2])
def test_one_that_is_stopped_before_or_while_it_is_written_leaves_nothing_behind(pair, names, requested):
    answers = iter([False] * (requested - 1) + [True] * 9)
    with pytest.raises(WaferViewerError, match="stopped"):
        subtract(pair[0], "difference-x", *names, "stage", False, should_stop=lambda: next(answers))
    assert not list((pair[0] / "results").glob("*difference-x*"))
    assert not list((pair[0] / "results").glob(".*"))


@pytest.mark.slow
def test_leftovers_of_a_killed_job_are_removed_by_the_next(pair, names):
    left = pair[0] / "results" / ".difference-y.999999999-abc123.part"
    left.mkdir()
    assert "difference-y" not in "".join(Dataset.open(pair[0]).results())
    subtract(pair[0], "difference-z", *names, "stage", False)
    assert not left.exists()


@pytest.mark.slow
def test_nothing_is_kept_of_what_cannot_be_compared(pair, names):
    with pytest.raises(DatasetError, match="compared with itself"):
        subtract(pair[0], "difference-q", names[0], names[0], "auto", False)
    with pytest.raises(DatasetError, match="no stitched surface"):
        subtract(pair[0], "difference-q", names[0], SurfaceName(path=names[1].path, result="levy"), "auto", False)
    assert not (pair[0] / "results" / "difference-q").exists()


@pytest.mark.campaign
def test_the_session_offers_compares_shows_measures_exports_and_removes(tmp_path, patience_s):
    before, after = two_datasets(tmp_path / "data")
    session = Session(tmp_path / "data")
    try:
        session.open_dataset(before).result(patience_s)
        pairs = session.comparing.choices()
        assert [second.words for _, second in pairs] == ["after", "before · cleaned"]
        number = session.comparing.begin(*pairs[0]).result(patience_s)
        given = session.wait_until(lambda now: now.comparisons and not now.works, patience_s).comparisons
        assert [(c.number, c.name, c.outdated) for c in given] == [(number, "difference-after", False)]

        show = show_of(number, ComparisonFace.DIFFERENCE)
        on_pad = session.read_out(100 + 330 + 6, 700 - 220 - 4, show)
        assert on_pad.z_um == pytest.approx(BUMP_UM, abs=0.4)
        pad, round_it = Region.rectangle(420, 465, 450, 485), Region.rectangle(350, 465, 390, 485)
        step = session.measure("step", (pad, round_it), show)
        assert step.height.value_um == pytest.approx(BUMP_UM, abs=0.1)
        assert session.surface_source(show_of(number, ComparisonFace.SECOND)).shape == session.mosaic().shape
        out = session.export_surface(tmp_path / "off.npz", show).result(patience_s)
        assert out.stat().st_size > 1e6

        busy = session.comparing.begin(*pairs[1])
        with pytest.raises(DatasetError, match="being compared already"):
            session.comparing.begin(*pairs[0]).result(patience_s)
        busy.result(patience_s)
        session.comparing.remove(number).result(patience_s)
        assert [c.name for c in session.snapshot.comparisons] == ["difference-before-cleaned"]
        with pytest.raises(DatasetError, match="comparison was deleted"):
            session.read_out(430, 470, show)

        pending = session.comparing.begin(*pairs[0])
        work = session.wait_until(lambda now: bool(now.works), patience_s).works[-1]
        assert (work.title, work.cancellable) == ("Compare with after", True)
        session.cancel(work.id).result(patience_s)
        with pytest.raises(ComputeError, match="was stopped"):
            pending.result(patience_s)
        session.wait_until(lambda now: not now.works, patience_s)
        assert Dataset.open(before).differences() == ("difference-before-cleaned",)

        session.close_dataset().result(patience_s)
        assert session.snapshot.comparisons == ()
        session.open_dataset(after).result(patience_s)
        assert session.snapshot.comparisons == ()
    finally:
        session.close()
