"""Files and names made to do harm: nothing of them is executed, nothing is read or written elsewhere."""

from __future__ import annotations

import io
import pickle
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.datasets.samples import make_job, make_surface
from tests.support.parsed_modules import MODULES, parsed
from tests.support.paths import ROOT
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.job_releases import free_place
from wafer_viewer.session.planning.plan_editor import suggested_name
from wafer_viewer.store.formats.conversion import export, read_surface
from wafer_viewer.store.formats.npz_file import read_npz
from wafer_viewer.store.formats.x3p import CHECKSUM
from wafer_viewer.store.mosaic.poses_file import read_planes, read_poses
from wafer_viewer.store.records.golden_dies import open_golden, save_golden
from wafer_viewer.store.records.inspection_records import save_defect_recipe
from wafer_viewer.store.tables.csv_tables import read_study

SECRET = "what another file holds"
HARMFUL_NAMES = ("../../evil", "/etc/cron.d/evil", "..", "a/../../evil", "..\\..\\evil", "evil\0", "~root/evil")


class Planted:
    """Object whose unpickling writes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def refused(read: Callable[[], object]) -> str:
    with pytest.raises(WaferViewerError) as error:
        read()
    return str(error.value)


@pytest.mark.parametrize("read", [read_npz, read_planes, read_poses, open_golden, read_surface])
@pytest.mark.parametrize("as_member", ["array", "pickle"])
def test_a_pickle_in_an_archive_is_not_opened(tmp_path: Path, read, as_member: str) -> None:
    mark, path, out = tmp_path / "executed", tmp_path / "planted.golden.npz", io.BytesIO()
    planted = np.array([Planted(mark)], dtype=object)
    if as_member == "array":
        np.save(out, planted, allow_pickle=True)
    else:
        pickle.dump(planted, out)
    with zipfile.ZipFile(path, "w") as file:
        for name in ("z_um", "header", "numbers", "shifts.first", "confidence", "origin"):
            file.writestr(f"{name}.npy", out.getvalue())
    assert str(path) in refused(lambda: read(path))
    assert not mark.exists()


@pytest.fixture
def x3p(tmp_path: Path) -> Callable[[Callable[[bytes], bytes]], Path]:
    """Write a surface as X3P with a changed main.xml."""

    def write(change: Callable[[bytes], bytes]) -> Path:
        good, bad = tmp_path / "good.x3p", tmp_path / "bad.x3p"
        export(make_surface(), good)
        with zipfile.ZipFile(good) as source, zipfile.ZipFile(bad, "w") as target:
            for name in sorted(set(source.namelist()) - {CHECKSUM}):  # whoever changes one file leaves out the other
                content = source.read(name)
                target.writestr(name, change(content) if name == "main.xml" else content)
        return bad

    return write


def with_doctype(doctype: str, used: str = "&x;") -> Callable[[bytes], bytes]:
    return lambda xml: xml.replace(b"?>", f"?><!DOCTYPE x [{doctype}]>".encode(), 1).replace(b"SUR", used.encode())


def test_an_external_entity_of_an_x3p_reads_no_file(tmp_path: Path, x3p) -> None:
    (tmp_path / "secret").write_text(SECRET)
    path = x3p(with_doctype(f'<!ENTITY x SYSTEM "file://{tmp_path}/secret">'))
    says = refused(lambda: read_surface(path))
    assert "has a document type" in says
    assert SECRET not in says


def test_entities_that_grow_without_bound_are_refused_before_they_do(x3p) -> None:
    laughs = '<!ENTITY a "ha">' + "".join(
        f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True)
    )
    assert "has a document type" in refused(lambda: read_surface(x3p(with_doctype(laughs, "&j;"))))


def test_an_entity_in_another_encoding_is_refused_too(x3p) -> None:
    def hide(xml: bytes) -> bytes:
        return with_doctype('<!ENTITY x "SUR">')(xml).replace(b"UTF-8", b"UTF-16", 1).decode().encode("utf-16")

    assert "has a document type" in refused(lambda: read_surface(x3p(hide)))


@pytest.mark.parametrize("name", ["../evil", "/tmp/evil", "..\\evil", "link"])
def test_a_member_with_a_path_or_a_link_is_not_unpacked(tmp_path: Path, name: str) -> None:
    good, bad = tmp_path / "in" / "good.x3p", tmp_path / "in" / "bad.x3p"
    good.parent.mkdir()
    export(make_surface(), good)
    with zipfile.ZipFile(good) as source, zipfile.ZipFile(bad, "w") as target:
        for info in source.infolist():
            target.writestr(info, source.read(info))
        member = zipfile.ZipInfo(name)
        if name == "link":
            member.external_attr = (stat.S_IFLNK | 0o777) << 16
        target.writestr(member, "/etc/passwd")
    before = sorted(tmp_path.rglob("*"))
    read_surface(bad)
    assert sorted(tmp_path.rglob("*")) == before
    assert not Path("/tmp/evil").exists()


def test_heights_behind_a_link_in_an_archive_are_no_heights(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.x3p", tmp_path / "bad.x3p"
    export(make_surface(), good)
    with zipfile.ZipFile(good) as source, zipfile.ZipFile(bad, "w") as target:
        target.writestr("main.xml", source.read("main.xml"))
        member = zipfile.ZipInfo("bindata/data.bin")
        member.external_attr = (stat.S_IFLNK | 0o777) << 16
        target.writestr(member, str(tmp_path / "good.x3p"))
    assert "bad.x3p" in refused(lambda: read_surface(bad))


def inside(folder: Path, path: Path) -> bool:
    return path.resolve().parent.parent == folder.resolve()


@pytest.mark.parametrize("name", HARMFUL_NAMES)
def test_a_product_or_a_name_leads_to_no_other_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    recipe = save_defect_recipe(folder, DefectRecipe(product=name, name=name))
    assert inside(folder, recipe)
    assert inside(folder, free_place(folder, replace(make_job(), product=name, revision=name)))
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


@pytest.mark.parametrize("name", HARMFUL_NAMES)
def test_a_lot_or_a_wafer_leads_to_no_other_folder(tmp_path: Path, name: str) -> None:
    job = replace(make_job(), sample=Sample(name=name, lot=name, wafer_id=name), product=name)
    proposed = suggested_name(job)
    assert (tmp_path / f"{proposed}.wafer").resolve().parent == tmp_path.resolve()
    assert proposed not in ("", ".", "..")
    assert not set(proposed) & set("/\\\0~")


@pytest.mark.parametrize("name", ["..", "a\0", "a;b", ".hidden", "a/.."])
def test_a_golden_die_has_a_plain_name(tmp_path: Path, name: str) -> None:
    header = GoldenHeader(product="LX-7", pixel_um=1.0, width_um=4.0, height_um=4.0, dies=12)
    die = GoldenDie(header, *[np.ones((4, 4), np.float32)] * 4)
    says = refused(lambda: save_golden(die, tmp_path / name))
    assert "cannot be called" in says
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["settings", "recipe", "certificate"])
def test_a_text_of_settings_is_no_program(tmp_path: Path, kind: str) -> None:
    from wafer_viewer.cli.parser import read_recipe
    from wafer_viewer.session.planning.job_releases import read_job
    from wafer_viewer.store.records.calibration_records import read_certificate

    mark, path = tmp_path / "executed", tmp_path / "settings.toml"
    path.write_text(f"product = \"{{__import__('os').system('touch {mark}')}}\"\nx = \"$(touch {mark})\"\n")
    read = {"settings": read_job, "recipe": read_recipe, "certificate": read_certificate}[kind]
    refused(lambda: read(path))
    assert not mark.exists()


@pytest.mark.slow
def test_nothing_of_the_package_unpickles_or_evaluates_what_it_reads() -> None:
    """No call of pickle, eval, exec, os.system, a shell or an unsafe loader of YAML is in the package."""
    forbidden = {"eval", "exec", "pickle.load", "pickle.loads", "os.system", "os.popen", "yaml.load", "marshal.loads"}
    found = [
        f"{module.relative_to(ROOT)}:{call.line}"
        for module in MODULES
        for call in parsed(module).calls
        if call.name in forbidden or call.switched_on & {"shell", "allow_pickle"}
    ]
    assert found == []


def test_the_test_of_pickles_would_see_one_executed(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    pickle.loads(pickle.dumps(Planted(mark)))
    assert mark.exists()


def test_a_name_of_a_study_is_shortened_in_the_sentence_about_it(tmp_path):
    path = tmp_path / "study.csv"
    path.write_text(f'part,appraiser,value\n1,A,1.0\n2,"{"(" * 5000}\n)",1.0\n')
    with pytest.raises(WaferViewerError, match=r"part 1 has 0 values of \({80}, the first has 1: everyone") as refused:
        read_study(path)
    assert "\n" not in str(refused.value)
