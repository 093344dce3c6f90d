"""Defects from the command line: JSON, files, a status by limits, and bad input in one sentence."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.patterned_surface import Wafer, made
from wafer_viewer.cli.app import main
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace as spec_replace
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.npz_file import write_npz
from wafer_viewer.store.records.golden_dies import open_golden, save_golden
from wafer_viewer.store.records.inspection_records import save_defect_recipe
from wafer_viewer.store.tables.klarf import read_klarf

WAFER = Wafer(unmeasured_fraction=0.0)
AT_UM = (480.0, 420.0)
LIES = ("--center-um", "0", "0", "--notch", "down", "--diameter-mm", "300", "--step", "METAL2")
GIVEN = ("--pitch-um", "201.3", "147.7", "--origin-um", "31.7", "22.9", "--size-um", "173", "121")


def bumped(surface: HeightMap) -> HeightMap:
    """With a dome, 12 um high and 60 um across."""
    rows, cols = surface.z_um.shape
    x = surface.x0_um + np.arange(cols)[None, :] * surface.pixel_um
    y = surface.y0_um - np.arange(rows)[:, None] * surface.pixel_um
    inside = 1 - ((x - AT_UM[0]) ** 2 + (y - AT_UM[1]) ** 2) / 30.0**2
    z = (surface.z_um + 12 * np.sqrt(np.clip(inside, 0, None))).astype(np.float32)
    return replace(surface, z_um=z, z_raw_um=z)


def plain(surface: HeightMap) -> HeightMap:
    """Without a pattern in heights or picture: a bare wafer, on which no dies are found."""
    noise = np.random.default_rng(4).normal(0, 0.1, surface.z_um.shape).astype(np.float32)
    return replace(surface, z_um=noise, z_raw_um=noise, all_in_focus=(100 + 10 * noise).astype(np.uint8))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("wafers")
    write_npz(bumped(made(WAFER)), path / "bumped.npz")
    write_npz(made(WAFER, gap=Region.rectangle(700, 500, 1100, 900)), path / "gap.npz")
    write_npz(bumped(plain(made(WAFER))), path / "plain.npz")
    return path


@pytest.mark.slow
def test_the_defect_is_reported_counted_and_exported(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = {what: str(tmp_path / f"w.{what}") for what in ("klarf", "e142", "sinf", "csv", "dies-csv", "training")}
    flags = [word for what, path in out.items() for word in (f"--{what}", path)]
    golden = ("--save-golden", str(tmp_path / "std"))
    status = main(["measure", "defects", str(folder / "bumped.npz"), *flags, *LIES, *golden, "--max-per-die", "0"])
    reported = json.loads(capsys.readouterr().out)
    worst = reported["inspection"]["defects"][0]
    assert (status, worst["kind"], reported["inspection"]["grid"]["by"]) == (1, "particle", "found")
    with Path(out["dies-csv"]).open() as file:
        dies = {line["die"]: line for line in csv.DictReader(file)}
    assert len(dies) == len(reported["inspection"]["dies"])
    assert all(abs(float(die["tilt_x_mrad"])) < 1.0 for die in dies.values() if die["state"] == "whole")
    assert worst["die"] in reported["verdict"]["failing"]
    assert not any(worst["number"] in place["numbers"] for place in reported["repeats"])
    assert worst["center"] == pytest.approx(AT_UM, abs=2.0)
    codes = [line.split() for line in Path(out["sinf"]).read_text().split("RowData:")[1:]]
    assert sum(row.count("0B") for row in codes) == len(reported["verdict"]["failing"])
    assert "<BinCode>" in Path(out["e142"]).read_text()
    klarf = read_klarf(out["klarf"])
    assert len(klarf.defects) == reported["verdict"]["counted"]
    with Path(out["csv"]).open() as file:
        assert len(list(csv.DictReader(file))) == len(reported["inspection"]["defects"])
    with (Path(out["training"]) / "features.csv").open() as file:
        row = next(csv.DictReader(file))
    heights = np.load(Path(out["training"]) / row["heights"])
    assert row["class"] == "particle"
    assert np.nanmax(heights) - np.nanmedian(heights) > 8
    assert open_golden(reported["files"]["golden"]).header.version == 1
    assert main(["measure", "defects", str(folder / "bumped.npz"), *GIVEN, "--other", out["klarf"]]) < 2
    beside = json.loads(capsys.readouterr().out)["other"]
    assert beside["places"] == len(klarf.defects)
    assert worst["number"] in beside["matched"].values()


@pytest.mark.slow
def test_within_its_limits_the_status_is_0(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    nested = tmp_path / "w.klarf"
    flags = (
        "--max-per-die",
        "50",
        "--sensitivity",
        "0.2",
        *GIVEN,
        "--klarf",
        str(nested),
        "--klarf-version",
        "1.8",
        *LIES,
        "--klarf-images",
    )
    assert main(["measure", "defects", str(folder / "bumped.npz"), *flags]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (reported["inspection"]["recipe"]["sensitivity"], reported["files"]) == (0.2, {"klarf": str(nested)})
    klarf = read_klarf(nested)
    assert (klarf.version, klarf.step, klarf.sample_mm) == ("1.8", "METAL2", 300.0)
    assert [d.images[0].page for d in klarf.defects] == list(range(1, len(klarf.defects) + 1))


@pytest.mark.campaign
def test_a_wafer_with_a_missing_field_is_not_clean(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["measure", "defects", str(folder / "gap.npz"), *GIVEN]) == 1
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict["not_inspected"]
    assert "not clean" in verdict["why"][0]


@pytest.mark.slow
def test_dies_that_are_not_found_are_never_within_the_limits(folder: Path, capsys: pytest.CaptureFixture[str]):
    call = ["measure", "defects", str(folder / "plain.npz")]
    assert main([*call, "--max-per-die", "0"]) == 2
    assert main([*call, "--against", "form", "--max-per-die", "0"]) == 2
    refused = capsys.readouterr()
    assert refused.out == ""
    assert "No die is known, so nothing per die can be judged: give the pitch" in refused.err
    assert main([*call, "--against", "form", "--max-per-mm2", "1000"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"]["word"] == "pass"
    assert main([*call, "--against", "form", *GIVEN, "--as-given", "--max-per-die", "0"]) == 1
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert (verdict["word"], len(verdict["failing"])) == ("fail", 1)


@pytest.mark.campaign
def test_areas_that_a_recipe_names_are_left_out_and_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    recipe = tmp_path / "areas.toml"
    call = ["measure", "defects", str(folder / "bumped.npz"), *GIVEN, "--sensitivity", "0.2"]
    main(call)
    worst = json.loads(capsys.readouterr().out)["inspection"]["defects"][0]
    at = ", ".join(f"[{worst['in_die'][0] + off}, {worst['in_die'][1] + off}]" for off in (-36, 36))
    recipe.write_text(f'[[excluded]]\nkind = "rectangle"\npoints = [{at}]')
    main([*call, "--recipe", str(recipe)])
    found = json.loads(capsys.readouterr().out)["inspection"]
    assert all(defect["center"] != pytest.approx(AT_UM, abs=30.0) for defect in found["defects"])
    assert any(note.startswith("Left out of every die, as the recipe asks: 1 area") for note in found["notes"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (("--origin-um", "200", "150"), "go with their pitch: give --pitch-um too"),
        (("--size-um", "200", "150"), "go with their pitch: give --pitch-um too"),
        (("--sensitivity", "3"), "sensitivity is 3.0: it must be between 0 and 1"),
        (("--recipe", "gone.toml"), "gone.toml cannot be read"),
        (("--golden", "gone.golden.npz"), "gone.golden.npz does not exist"),
        (("--golden", "x.golden.npz", "--against", "form"), "leave --golden or --against form out"),
        (("--other", "gone.klarf"), "gone.klarf cannot be read, it does not exist"),
        (("--max-per-die", "-1"), "max_per_die is -1: it must be at least 0"),
        (("--klarf", "w.klarf"), "A KLARF states the wafer's centre on the stage (align the wafer, or --center-um)"),
        (("--sinf", "w.sinf", "--max-per-die", "0"), "it is not known: give it (--notch)"),
        (("--sinf", "w.sinf"), "set max_per_die (--max-per-die), such as 0"),
    ],
)
def test_bad_input_is_one_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], sentence: str
):
    assert main(["measure", "defects", str(folder / "bumped.npz"), *flags]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1


@pytest.mark.campaign
def test_a_golden_die_of_another_product_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    recipe = tmp_path / "r.toml"
    for product, flags in (("A", ("--save-golden", str(tmp_path / "std"))), ("B", ())):
        recipe.write_text(f'product = "{product}"')
        golden = () if flags else ("--golden", str(tmp_path / "std.1.golden.npz"))
        status = main(
            ["measure", "defects", str(folder / "bumped.npz"), "--recipe", str(recipe), *GIVEN, *flags, *golden]
        )
        assert (status == 2) == bool(golden)
    assert "is of product 'A' and this wafer is of 'B'" in capsys.readouterr().err


@pytest.fixture(scope="module")
def dataset(folder: Path) -> Path:
    """A dataset of product LX-7, with a golden die and a recipe that names it beside."""
    from wafer_viewer.session.files.file_jobs import import_surface
    from wafer_viewer.store.dataset.scan_record import read_record, write_record

    path = import_surface(folder / "bumped.npz", folder / "w7.wafer")
    record = read_record(path)
    write_record(path, spec_replace(record, job=spec_replace(record.job, product="LX-7")))
    save_defect_recipe(folder, DefectRecipe(product="LX-7", name="keen", sensitivity=0.2, golden="lx7"))
    return path


@pytest.mark.campaign
def test_the_recipe_of_the_product_is_taken_by_itself_with_its_golden_die(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    torn = dataset.parent / "recipes" / "LX-7-torn.defects.toml"
    torn.write_text("sensitvity = 0.5")
    assert main(["measure", "defects", str(dataset), *GIVEN]) == 2
    torn.unlink()
    refused = capsys.readouterr().err
    assert "LX-7-torn.defects.toml: unknown key 'sensitvity'" in refused
    assert "Recipe 'keen' of LX-7 is used" in refused
    assert "no golden die 'lx7'" in refused
    plain = tmp_path / "plain.toml"
    plain.write_text('product = "LX-7"')
    golden = dataset.parent / "golden" / "lx7"
    assert main(["measure", "defects", str(dataset), *GIVEN, "--recipe", str(plain), "--save-golden", str(golden)]) < 2
    assert "is used because" not in capsys.readouterr().err
    assert main(["measure", "defects", str(dataset), *GIVEN]) < 2
    reported = json.loads(capsys.readouterr().out)["inspection"]
    assert (reported["recipe"]["name"], reported["reference"], reported["recipe"]["sensitivity"]) == (
        "keen",
        "golden",
        0.2,
    )


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("header", "says"),
    [
        ({"product": "LX-8"}, "is of product 'LX-8' and this wafer is of 'LX-7': choose a golden die of this product"),
        ({"pixel_um": 1.0}, "has pixels of 1 um and this surface of 2 um"),
        ({"width_um": 120.0}, "has dies of 120 x 121 um and this wafer of 173 x 121 um"),
    ],
)
def test_a_golden_die_of_something_else_is_refused_in_a_sentence(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], header: dict[str, object], says: str
):
    own = {"product": "LX-7", "pixel_um": made(WAFER).pixel_um, "width_um": 173.0, "height_um": 121.0, "dies": 9}
    layer = np.zeros((12, 17), np.float32)
    path = save_golden(GoldenDie(GoldenHeader(**own | header), *[layer] * 4), tmp_path / "std")
    assert main(["measure", "defects", str(dataset), *GIVEN, "--golden", str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert says in captured.err


@pytest.mark.slow
def test_result_is_kept_where_a_file_cannot_be_written(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    blocked = tmp_path / "a file"
    blocked.write_text("")
    table = tmp_path / "w.csv"
    flags = ("--klarf", str(blocked / "w.klarf"), "--csv", str(table), "--max-per-die", "50", *LIES)
    status = main(["measure", "defects", str(folder / "bumped.npz"), *GIVEN, *flags])
    printed = capsys.readouterr()
    reported = json.loads(printed.out)
    assert (status, reported["files"]) == (1, {"csv": str(table)})
    assert reported["inspection"]["defects"]
    assert "w.klarf was not written, and the result is kept" in printed.err
