"""From a surface to a hand-over with a true session: inspected by its workers, judged, kept, written, opened again."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from tests.support.noisy_wafer import Planted, wafer
from tests.support.patience import PATIENCE_S
from wafer_viewer.measure.defects.learned_classes import judged_defects
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.inspection.klarf import KlarfExport
from wafer_viewer.model.progress import silent
from wafer_viewer.model.spec import replace
from wafer_viewer.session.inspection.inspection_job import GivenDies, wafer_of
from wafer_viewer.session.inspection.inspection_job import inspected as search_headless
from wafer_viewer.session.session import Session
from wafer_viewer.store.formats.npz_file import write_npz
from wafer_viewer.store.records.golden_dies import open_golden
from wafer_viewer.store.records.inspection_records import read_judged, save_judged
from wafer_viewer.store.tables.klarf import read_klarf

pytestmark = pytest.mark.campaign(together=True)
BUMP, PIT = Planted("bump", 250.0, 392.0, 30, 8), Planted("pit", 110.0, 110.0, 24, 10)
RECIPE = DefectRecipe(product="LX-7", name="dull", sensitivity=0.25, limits=DefectLimits(max_per_die=0))


@pytest.fixture(scope="module")
def made():
    return wafer(1, (3, 3), (120, 140), (BUMP, PIT))


@pytest.fixture(scope="module")
def inspected(tmp_path_factory, made):
    """A session with a dataset that was searched, and one defect judged."""
    folder = tmp_path_factory.mktemp("data")
    write_npz(made.surface, folder / "w7.npz")
    session = Session(folder)
    path = session.exchange.import_surface(folder / "w7.npz").result(PATIENCE_S)
    session.wait_until(lambda now: now.surface is not None, PATIENCE_S)
    found = session.defects.inspect(RECIPE, made.grid).result(PATIENCE_S)
    session.defects.judge(found.found[0].number, "real", "residue", "gel?").result(PATIENCE_S)
    session.defects.judge(found.found[1].number, "nuisance").result(PATIENCE_S)
    yield session, path
    session.close()


def test_export_and_import_round_trip_without_loss(inspected, tmp_path: Path):
    session, path = inspected
    shown = session.snapshot.inspection.inspection
    assert (shown.reference, shown.grid.by, len(shown.found) >= 2) == ("dies", "given", True)
    files = session.defects.files
    with pytest.raises(DatasetError, match="give what is missing, nothing is assumed"):
        files.write("klarf", tmp_path / "w7.klarf").result(PATIENCE_S)
    stated = KlarfExport(center_x_um=0.0, center_y_um=0.0, notch="down", diameter_mm=1.0, step="etch")
    klarf = files.write("klarf", tmp_path / "w7.klarf", stated).result(PATIENCE_S)
    assert [d.bin for d in read_klarf(klarf).defects][:2] == [1, 2]
    with files.write("csv", tmp_path / "w7.csv").result(PATIENCE_S).open() as table:
        first = next(csv.DictReader(table))
    assert (first["class"], first["judgement"], first["note"]) == ("residue", "real", "gel?")
    folder = files.write("training", tmp_path / "set").result(PATIENCE_S)
    assert len(list(folder.glob("*.npy"))) == len(shown.found)
    other = files.lay_over(klarf).result(PATIENCE_S)
    assert len(other.matched(shown.found)) == len(shown.found)
    assert session.snapshot.works == ()

    session.close_dataset().result(PATIENCE_S)
    assert session.snapshot.inspection.inspection is None
    assert session.snapshot.defect_files.other is None
    session.open_dataset(path).result(PATIENCE_S)
    again = session.snapshot.inspection
    assert again.inspection == shown
    assert not again.stale


def test_a_golden_die_and_a_recipe_serve_the_next_inspection(inspected, made):
    session, _ = inspected
    files = session.defects.files
    stored = files.keep_golden("lx7").result(PATIENCE_S)
    assert (stored.parent.name, open_golden(stored).header.product) == ("golden", "LX-7")
    session.wait_until(lambda now: bool(now.defect_files.golden), PATIENCE_S)
    files.save_recipe(DefectRecipe(product="LX-7", golden="lx7", sensitivity=0.25)).result(PATIENCE_S)
    assert [header.name for header in session.snapshot.defect_files.golden] == ["lx7"]
    found = session.defects.inspect(session.snapshot.defect_files.recipe_of("LX-7"), made.grid).result(PATIENCE_S)
    assert found.reference == "golden"
    judged = session.snapshot.inspection.inspection.found
    assert {"real", "nuisance"} <= {defect.judgement for defect in judged}


def test_judgements_kept_with_the_product_propose_classes_at_the_next_inspection(inspected, made):
    session, path = inspected
    with pytest.raises(MeasureError, match="at least 8 judged defects"):
        session.defects.propose_classes().result(PATIENCE_S)
    found = session.snapshot.inspection.inspection
    own = judged_defects(found, made.surface, wafer="w7/default")
    others = tuple(replace(own.defects[n % 2], wafer="w6/default", number=n) for n in range(10))
    save_judged(path.parent, replace(own, defects=others))
    proposed = session.defects.propose_classes().result(PATIENCE_S)
    assert (proposed.learned.judged, proposed.learned.wafers) == (12, 2)
    assert session.snapshot.inspection.inspection.learned == proposed.learned
    kept = read_judged(path.parent, "LX-7").defects
    assert [(d.wafer, d.kind) for d in kept[10:]] == [("w7/default", "residue"), ("w7/default", "nuisance")]
    own_dies = GivenDies(
        pitch_um=(made.grid.pitch_x_um, made.grid.pitch_y_um),
        origin_um=(made.grid.x0_um, made.grid.y0_um),
        size_um=(made.grid.width_um, made.grid.height_um),
    )
    headless = search_headless(wafer_of(path, "default"), RECIPE, own_dies, None, "dies", silent)
    assert headless.learned == proposed.learned, "each judgement counts once, those carried over too"
    again = session.defects.inspect(RECIPE, made.grid).result(PATIENCE_S)
    assert again.learned is not None
    assert {defect.learned.kind for defect in again.found} <= {"residue", "nuisance"}
    next((path.parent / "recipes").glob("*.judged.json")).write_text("{}", encoding="utf-8")
    damaged = session.defects.inspect(RECIPE, made.grid).result(PATIENCE_S)
    assert damaged.learned is None
    assert any("No classes are proposed from judgements" in note for note in damaged.notes)


def test_a_golden_die_of_another_product_is_refused(inspected, made):
    session, _ = inspected
    session.defects.files.keep_golden("lx7").result(PATIENCE_S)
    of_another = DefectRecipe(product="LX-8", golden="lx7")
    with pytest.raises((DatasetError, MeasureError), match=r"'lx7' is of product 'LX-7', not of 'LX-8'"):
        session.defects.inspect(of_another, made.grid).result(PATIENCE_S)
    assert "not of 'LX-8'" in session.snapshot.inspection.problem
