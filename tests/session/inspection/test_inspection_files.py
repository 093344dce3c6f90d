"""Recipes, golden dies and files of defects: kept beside the datasets, written, read, and laid over what was found."""

from __future__ import annotations

import errno
import io
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from PIL import Image

from tests.support.datasets.compared_datasets import two_datasets
from tests.support.datasets.inspections import GRID, defect, inspection, written_klarf
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import ControlHeldError, DatasetError, MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.inspection.klarf import KlarfExport, KlarfImage
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.background_work import BackgroundWork, Notifications
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import restricted_session
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.inspection.inspection_commands import DefectController
from wafer_viewer.session.inspection.inspection_files import (
    DefectFiles,
    compared,
    hand_over,
    keep_golden,
    lattice_for,
    read_klarf_image,
)
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.images.image_files import states_simulated
from wafer_viewer.store.records.inspection_records import read_inspection, write_inspection
from wafer_viewer.store.tables.klarf import read_klarf

STATED = KlarfExport(center_x_um=0.0, center_y_um=0.0, notch="down", diameter_mm=300.0, step="METAL2")
FOUND = inspection(defect(1, "1,1", 300.0, 400.0), defect(2, "1,1", 500.0, 300.0))


class AtOnce:
    """A compute host that does what it is asked at once."""

    def run(self, work: str, task, *args) -> Future:
        done: Future = Future()
        try:
            done.set_result(task(*args))
        except (DatasetError, MeasureError) as fault:
            done.set_exception(fault)
        return done

    lead = run

    def cancel(self, work: str) -> None: ...


class Bench:
    """The parts of a session that keep defects and what belongs to them, on its thread."""

    def __init__(self, path: Path) -> None:
        self.folder, self.command_queue = path.parent, CommandQueue(Snapshot())
        notices, compute = Notifications(self.command_queue), AtOnce()
        self.library = Library(self.command_queue, self.folder)
        background = BackgroundWork(self.command_queue, notices, compute)
        self.controller = DefectFiles(self.command_queue, self.library, background, self.folder)
        self.defects = DefectController(self.command_queue, self.library, background, self.controller, None)
        self.do(self.library.open, path)
        self.do(self.defects.open)
        self.do(self.controller.open)

    def do(self, command, *args):
        return self.command_queue.do(command, *args).result(20)

    @property
    def shelf(self):
        return self.command_queue.snapshot.defect_files

    def close(self) -> None:
        self.do(self.library.close)
        self.command_queue.close()


@pytest.fixture(scope="module")
def inspected(tmp_path_factory) -> Path:
    """A dataset of which something was found."""
    path = two_datasets(tmp_path_factory.mktemp("files"))[0]
    write_inspection(Dataset.open(path).result("default").path, FOUND)
    return path


@pytest.fixture
def bench(inspected):
    made = Bench(inspected)
    yield made
    made.close()


@pytest.mark.slow
def test_recipes_are_kept_renamed_and_deleted_and_that_saved_last_is_taken_by_itself(bench):
    keen = DefectRecipe(product="LX-7", name="keen", sensitivity=0.7)
    path = bench.do(bench.controller.save_recipe, keen)
    assert path.parent == bench.folder / "recipes"
    assert bench.shelf.recipe_of("LX-7") == keen
    bench.do(bench.controller.rename_recipe, keen, "night")
    night = replace(keen, name="night")
    assert bench.shelf.recipes == (night,)
    path.with_name("LX-7-torn.defects.toml").write_text("sensitvity = 1")
    bench.do(bench.controller.refresh)
    assert bench.shelf.recipes == (night,)
    assert "unknown key 'sensitvity'" in bench.shelf.problems[0]
    bench.do(bench.controller.delete_recipe, night)
    assert bench.shelf.recipes == ()


def test_limits_hold_for_what_was_found_and_can_be_undone(bench, inspected):
    strict = DefectLimits(max_per_die=1)
    bench.do(bench.defects.limit, strict)
    assert read_inspection(Dataset.open(inspected).result("default").path).recipe.limits == strict
    bench.do(bench.defects.undo)
    assert bench.command_queue.snapshot.inspection.inspection.recipe.limits == DefectLimits()


def test_defects_go_out_as_they_are_judged(bench, tmp_path):
    bench.do(bench.defects.judge, 1, "nuisance", "pit", None)
    klarf = bench.do(bench.controller.write, "klarf", tmp_path / "w.klarf", STATED)
    stored = read_klarf(klarf)
    assert [(d.number, d.bin, d.class_name) for d in stored.defects] == [(1, 2, "Pit"), (2, 0, "Particle")]
    table = bench.do(bench.controller.write, "csv", tmp_path / "w.csv").read_text()
    assert ",pit,particle," in table.splitlines()[1]
    folder = bench.do(bench.controller.write, "training", tmp_path / "set")
    assert (folder / "0002.npy").exists()
    with Image.open(folder / "0002.png") as cut:
        assert states_simulated(cut.info["Description"]) == FOUND.defects[1].simulated
    assert bench.command_queue.snapshot.works == ()
    with pytest.raises(DatasetError, match="exists already: give the name of a new folder"):
        bench.do(bench.controller.write, "training", tmp_path / "set")


def test_a_wafer_map_follows_limit_and_judgement(bench, tmp_path):
    with pytest.raises(MeasureError, match="set max_per_die"):
        bench.do(bench.controller.write, "e142", tmp_path / "w.xml", STATED)
    bench.do(bench.defects.limit, DefectLimits(max_per_die=0))
    assert (
        "0B"
        in bench.do(bench.controller.write, "sinf", tmp_path / "w.sinf", STATED).read_text().split("RowData:", 1)[1]
    )
    for number in (1, 2):
        bench.do(bench.defects.judge, number, "nuisance", None, None)
    assert (
        'BinCode="0B" BinCount="0"' in bench.do(bench.controller.write, "e142", tmp_path / "w.xml", STATED).read_text()
    )
    for number in (1, 2):
        bench.do(bench.defects.judge, number, "open", None, None)
    bench.do(bench.defects.limit, DefectLimits())


def test_a_klarf_goes_out_in_both_versions(bench, tmp_path):
    files = [bench.do(bench.controller.write, kind, tmp_path / kind, STATED) for kind in ("klarf", "klarf18")]
    assert [read_klarf(file).version for file in files] == ["1.2", "1.8"]


@pytest.mark.parametrize("what", ["klarf", "csv", "training"])
def test_a_place_that_cannot_be_written_to_is_reported(bench, tmp_path, what):
    with pytest.raises(DatasetError, match=r"cannot be written: its folder does not exist"):
        bench.do(bench.controller.write, what, tmp_path / "gone" / "w.out", STATED)
    assert bench.command_queue.snapshot.works == ()


@pytest.mark.parametrize("what", ["klarf", "csv", "training"])
def test_a_full_disk_is_reported_and_nothing_is_left_there(bench, tmp_path, monkeypatch, what):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(DatasetError, match="the disk is full: free some space"):
        bench.do(bench.controller.write, what, tmp_path / "w.out", STATED)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_what_was_not_inspected_is_not_handed_over(tmp_path):
    path = two_datasets(tmp_path)[1]
    with pytest.raises(DatasetError, match="after was not inspected for defects yet: inspect it first"):
        hand_over(path, "default", "klarf", tmp_path / "w.klarf")
    write_inspection(Dataset.open(path).result("default").path, replace(FOUND, grid=None, dies=()))
    with pytest.raises(MeasureError, match="has none: inspect die to die first"):
        keep_golden(path, "default", "lx7")
    with pytest.raises(DatasetError, match="write a CSV"):
        hand_over(path, "default", "klarf", tmp_path / "w.klarf", STATED)


def test_places_on_a_surface_that_is_another_by_now_are_cut_out_of_none(inspected, tmp_path):
    stored = Dataset.open(inspected).result("default").path
    write_inspection(stored, replace(FOUND, mark="of an older surface"))
    for requested in ((hand_over, "training", tmp_path / "set"), (keep_golden, "lx7")):
        with pytest.raises(DatasetError, match="reconstructed since it was inspected: inspect it again"):
            requested[0](inspected, "default", *requested[1:])
    assert hand_over(inspected, "default", "csv", tmp_path / "w.csv").exists()
    write_inspection(stored, FOUND)


def test_what_another_tool_found_is_overlaid_and_matched(bench, tmp_path):
    more = replace(FOUND, defects=(FOUND.defects[0], defect(7, "2,1", 50.0, 60.0)))
    other = bench.do(bench.controller.lay_over, written_klarf(more, tmp_path / "other.klarf"), None, 25.0)
    assert other.matched(FOUND.defects) == {1: 1}
    ((missed, place),) = other.unmatched(FOUND.defects)
    assert (missed.number, missed.col, missed.row) == (7, 2, 1)
    at = more.defects[1].center
    assert (place.points[0].x_um, place.points[0].y_um) == pytest.approx((at.x_um, at.y_um), abs=0.01)
    reported = compared(other, FOUND)
    assert (reported["matched"], reported["not_found_here"], reported["not_in_file"]) == ({"1": 1}, [7], [2])
    assert bench.shelf.other is other
    bench.do(bench.controller.take_away)
    assert bench.shelf.other is None


def test_images_of_another_tool_are_shown_and_what_lacks_is_told(bench, tmp_path):
    grey = np.stack([np.full((40, 60), 60 * k, np.uint8) for k in (1, 2)])
    tifffile.imwrite(tmp_path / "w.tif", grey)
    listed = "DefectList\n 1 300.000 400.000 1 1 12.000 10.000 94.000 12.000 1 1 0 0 0 6.000 "
    path = written_klarf(FOUND, tmp_path / "other.klarf")
    assert listed + "0 0\n" in path.read_text()
    with_images = "TiffFileName w.tif;\n" + listed + "2 2\n 2 0\n 1 0\n"
    path.write_text(path.read_text().replace(listed + "0 0\n", with_images))
    other = bench.do(bench.controller.lay_over, path, None, 25.0)
    assert other.klarf.notes == ()
    with Image.open(io.BytesIO(other.pictures[1])) as picture:
        assert (picture.size, round(np.asarray(picture).mean())) == ((60, 40), 120), "page 2 is listed first"
    assert compared(other, FOUND)["images"] == {"1": ["w.tif, page 2", "w.tif, page 1"]}
    assert other.klarf.notes == ()
    tifffile.imwrite(tmp_path / "w.tif", grey.astype(float))
    damaged = bench.do(bench.controller.lay_over, path, None, 25.0)
    assert damaged.klarf.notes == ("The image w.tif cannot be read: save it as an image of 8 or 16 bits.",)
    (tmp_path / "w.tif").unlink()
    without = bench.do(bench.controller.lay_over, path, None, 25.0)
    assert without.klarf.notes == ("The image w.tif is not next to its KLARF file: copy it there.",)
    away = KlarfImage(file="..\\..\\secret.tif")
    with pytest.raises(DatasetError, match=r"The image secret.tif is not next"):
        read_klarf_image(tmp_path, away)


def test_a_klarf_is_not_written_before_the_wafer_is_aligned(bench, tmp_path):
    with pytest.raises(DatasetError, match=r"the wafer's centre on the stage \(align the wafer"):
        bench.do(bench.controller.write, "klarf", tmp_path / "w.klarf")
    images = replace(STATED, images=True)
    path = bench.do(bench.controller.write, "klarf", tmp_path / "w.klarf", images)
    assert [d.images[0].page for d in read_klarf(path).defects] == [1, 2]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["w.klarf", "w.tif"]


def test_a_class_table_gives_the_classes_of_judgements(bench, tmp_path):
    from tests.store.records.test_class_table import TABLE

    (path := tmp_path / "classes.toml").write_text(TABLE)
    with pytest.raises(DatasetError, match="There is no class 'Probe mark': choose one of particle, scratch"):
        bench.do(bench.defects.judge, 1, "real", "Probe mark", None)
    bench.do(bench.defects.load_classes, path)
    bench.do(bench.defects.judge, 1, "real", "Probe mark", None)
    state = bench.command_queue.snapshot.inspection
    assert (state.defect(1).seen_as, state.inspection.recipe.class_table["particle"].title) == ("Probe mark", "Fall-on")
    klarf = read_klarf(bench.do(bench.controller.write, "klarf", tmp_path / "w.klarf", STATED))
    assert [d.class_number for d in klarf.defects] == [57, 41]
    for _ in range(2):
        bench.do(bench.defects.undo)
    assert bench.command_queue.snapshot.inspection.inspection.recipe.classes == ()


def test_it_is_removed_when_another_surface_is_shown(bench, tmp_path):
    bench.do(bench.controller.lay_over, written_klarf(FOUND, tmp_path / "other.klarf"), None, 25.0)
    bench.do(bench.controller.open)
    assert bench.shelf.other is None


def shortened(text: str) -> str:
    return text[: len(text) // 2]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (shortened, "is cut off, it has no EndOfFile"),
        (lambda text: "", "is not a KLARF file"),
        (lambda text: text.replace("DiePitch", "DiePith"), "it has no record DiePitch"),
        (lambda text: text.replace(" 1 2 ", " 1 3 ", 1), "its summary counts 3 defects and 2 are listed"),
        (lambda text: text.replace("DiePitch 1000.000000 800", "DiePitch 1000000 800000"), "in another unit"),
        (lambda text: text.replace("DiePitch 1000.000000", "DiePitch 1200.000000"), "is of another product, or"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_in_a_sentence(bench, tmp_path, damage, says):
    path = written_klarf(FOUND, tmp_path / "other.klarf")
    path.write_text(damage(path.read_text()))
    with pytest.raises(DatasetError, match=says):
        bench.do(bench.controller.lay_over, path, None, 25.0)
    assert bench.shelf.other is None


def test_a_distance_of_nothing_is_refused(bench, tmp_path):
    with pytest.raises(DatasetError, match="within 0 um: give more than 0"):
        bench.do(bench.controller.lay_over, written_klarf(FOUND, tmp_path / "other.klarf"), None, 0.0)


def test_another_numbering_of_dies_is_identified_by_the_wafers_center(tmp_path):
    center_um = (130.0, -40.0)
    lies = Alignment(shift_x_um=-center_um[0], shift_y_um=-center_um[1], n_marks=2)
    theirs = replace(GRID, x0_um=GRID.x0_um + GRID.pitch_x_um, y0_um=GRID.y0_um - 2 * GRID.pitch_y_um)
    path = written_klarf(replace(FOUND, grid=theirs), tmp_path / "other.klarf", center_um=center_um)
    read = read_klarf(path)
    assert read.defects[0].col == 0
    grid, by = lattice_for(read, lies, FOUND, path.name)
    assert by == "dies by the wafer's centre"
    assert read.matched(FOUND.defects, 1.0, grid) == {1: 1, 2: 2}
    at_zero = written_klarf(replace(FOUND, grid=theirs), tmp_path / "zero.klarf")
    grid, by = lattice_for(read_klarf(at_zero), None, FOUND, path.name)
    assert by.endswith("taken to be at the stage's zero")
    assert read_klarf(at_zero).matched(FOUND.defects, 1.0, grid) == {1: 1, 2: 2}
    grid, by = lattice_for(read, lies, None, path.name)
    assert read.matched(FOUND.defects, 1.0, grid) == {1: 1, 2: 2}
    assert by.startswith("its own dies")


def test_an_observer_can_export_but_not_save(bench, tmp_path):
    complete = SimpleNamespace(snapshot=bench.command_queue.snapshot, defects=bench.defects)
    watcher = restricted_session(complete, lambda: "b").defects.files
    assert watcher.write("csv", tmp_path / "w.csv").result(20).exists()
    for requested in (watcher.keep_golden("lx7"), watcher.save_recipe(DefectRecipe(product="LX-7"))):
        with pytest.raises(ControlHeldError):
            requested.result(20)
