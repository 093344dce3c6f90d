"""Files that are damaged, say no unit, contradict themselves or hold something else: one sentence each, no surface."""

from __future__ import annotations

import contextlib
import io
import json
import re
import zipfile

import numpy as np
import pytest
import tifffile
from PIL import Image

from tests.support.datasets.samples import make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import READ, WRITTEN
from wafer_viewer.store.formats.conversion import export, read_surface

Z = np.arange(12, dtype="<f4").reshape(3, 4)


def written(path, ending):
    """A good file of ours, as bytes."""
    target = path.with_name(f"good{ending}")
    export(make_surface(), target)
    content = target.read_bytes()
    target.unlink()
    return content


def gsf(**changes):
    """A GSF file of another program; a key that is None is left out."""
    keys = {"XRes": 4, "YRes": 3, "XReal": 4e-6, "YReal": 3e-6, "XYUnits": "m", "ZUnits": "m"} | changes
    head = "Gwyddion Simple Field 1.0\n" + "".join(f"{k} = {v}\n" for k, v in keys.items() if v is not None)
    return head.encode() + b"\0" * (4 - len(head) % 4) + Z.tobytes()


def x3p(path, change=lambda name, content: content, leave_out=()):
    """A good X3P with members changed, and no checksum of main.xml unless it is kept."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(written(path, ".x3p"))) as good, zipfile.ZipFile(out, "w") as bad:
        for name in good.namelist():
            if name not in leave_out:
                bad.writestr(name, change(name, good.read(name)))
    return out.getvalue()


def in_main(old, new):
    """Change main.xml and leave its checksum out."""

    def made(path):
        def change(name, content):
            return re.sub(old, new, content, count=1, flags=re.DOTALL) if name == "main.xml" else content

        return x3p(path, change, leave_out=("md5checksum.hex",))

    return made


def tiff(array, **options):
    out = io.BytesIO()
    tifffile.imwrite(out, array, **options)
    return out.getvalue()


def png():
    out = io.BytesIO()
    Image.fromarray(Z.astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


def npz(**arrays):
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def blind(ending):
    def made(path):
        surface = make_surface()
        surface.z_um[:], surface.z_raw_um[:], surface.origin[:] = np.nan, np.nan, 12
        export(surface, path)
        return path.read_bytes()

    return made


def changed_data(path):
    return x3p(path, lambda name, content: b"\0" * 8 + content[8:] if name.endswith(".bin") else content)


TABLE = "\n".join(f"{c},{-r},{Z[r, c]}" for r, c in np.ndindex(3, 4))
ASCII_PLY = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n{z}end_header\n0 0 0\n1 1 1\n"
CM = {"resolution": (1e4, 1e4), "resolutionunit": "CENTIMETER"}
UM = json.dumps({"unit": "um", "pixel_um": 1.0})

FAULTS = {
    # no unit, two units
    "no unit.gsf": (gsf(ZUnits=None), "states no unit of its heights: give it, as in --z-unit um"),
    "no pixel.gsf": (gsf(XYUnits=None), "states no pixel size: give it, as in --pixel-um 0.5"),
    "volts.gsf": (gsf(ZUnits="V"), "gives its heights in 'V', which is not a unit of length"),
    "twice.gsf": (gsf().replace(b"ZUnits = m\n", b"ZUnits = m\nZUnits = nm\n"), "states ZUnits twice, m and nm"),
    "oblong.gsf": (gsf(YReal=40e-6), "has pixels of 1 x 13.33333 um, over ten times as long as wide: resample it"),
    "no unit.csv": (TABLE.encode(), "states no unit of its heights"),
    "two units.csv": (
        f"# unit: mm\nx_um,y_um,z_um\n{TABLE}".encode(),
        "states the unit mm, but its x is in um",
    ),
    "one unit.csv": (f"x_um,y,z\n{TABLE}".encode(), "gives no unit for y and z"),
    "no unit.ply": (ASCII_PLY.format(z="property float z\n").encode(), "states no unit of its heights"),
    "no unit.tif": (tiff(Z), "states no unit of its heights"),
    "a screen's.tif": (
        tiff(Z, resolution=(72, 72), description='{"unit": "um"}', metadata=None),
        "states no pixel",
    ),
    "two pixels.tif": (
        tiff(Z, description=json.dumps({"unit": "um", "pixel_um": 2.0}), metadata=None, **CM),
        "states pixels of 2 um, but 1 um by its resolution",
    ),
    # z upside down, mirrored
    "depth.gsf": (gsf(Title="Depth map"), "holds depths, not heights .*--invert-z"),
    "depth.csv": (f"x_um,y_um,depth_um\n{TABLE}".encode(), "holds depths, not heights"),
    "depth.tif": (tiff(Z, description='{"quantity": "depth", "unit": "um"}', metadata=None, **CM), "holds depths"),
    "down.x3p": (in_main(rb"(<CZ>.*?<Increment>)1.0", rb"\g<1>-1.0"), "has z upside down, its increment is negative"),
    "mirrored.x3p": (in_main(rb"(<CX>.*?<Increment>)", rb"\g<1>-"), "is mirrored"),
    "turned.tif": (
        tiff(Z, description=UM, metadata=None, extratags=[(274, 3, 1, 4, True)]),
        "stored turned or mirrored",
    ),
    # cut off, changed
    "cut.x3p": (lambda p: written(p, ".x3p")[:4000], "is cut off or damaged: its zip archive"),
    "cut.gwy": (lambda p: written(p, ".gwy")[:4000], "is cut off or damaged"),
    "cut.gsf": (gsf()[:-4], "is cut off or too long"),
    "cut.ply": (lambda p: written(p, ".ply")[:-9], "is truncated, it has fewer points"),
    "cut.pcd": (lambda p: written(p, ".pcd")[:-9], "is truncated, it has fewer points"),
    "cut.tif": (lambda p: written(p, ".tif")[:3000], "cannot be read as TIFF"),
    "changed.x3p": (changed_data, "was changed after it was written, the checksum of its heights is wrong"),
    "main.x3p": (
        lambda p: x3p(p, lambda n, c: c.replace(b"SUR", b"PRF") if n == "main.xml" else c),
        "checksum of its main.xml",
    ),
    "no data.x3p": (
        lambda p: x3p(p, leave_out=("bindata/data.bin",)),
        "has no bindata/data.bin, which holds its heights",
    ),
    "short.x3p": (in_main(rb"<SizeY>30", b"<SizeY>31"), "has fewer heights than its header states"),
    # something else
    "text.gsf": (b"Gwyddion", "has no header of a GSF file"),
    "no size.gsf": (gsf(XRes=None), "has no XRes in its header"),
    "profile.x3p": (in_main(b"SUR", b"PRF"), "holds 'PRF' and no surface"),
    "zip.x3p": (npz(a=Z), "is not an X3P file, it has no main.xml"),
    "bomb.x3p": (in_main(rb"\?>", b"?><!DOCTYPE x []>"), "has a document type"),
    "text.gwy": (b"hello", "is not a GWY file"),
    "no z.ply": (ASCII_PLY.format(z="").encode(), "has no z among the properties of its points"),
    "text.ply": (b"hello", "has no header of a PLY file"),
    "no z.pcd": (lambda p: written(p, ".pcd").replace(b"FIELDS x y z", b"FIELDS x y i"), "has no z among its fields"),
    "packed.pcd": (
        lambda p: written(p, ".pcd").replace(b"DATA binary", b"DATA binary_compressed"),
        "as binary_compressed",
    ),
    "no z.csv": (b"x_um,y_um,i\n1,2,3\n", "has no column z"),
    "two columns.xyz": (b"1 2\n3 4\n", "has fewer than three columns"),
    "words.csv": (b"x_um,y_um,z_um\n1,2,three\n", "has lines without numbers"),
    "line.csv": (b"x_um,y_um,z_um\n1,2,3\n2,2,3\n", "has its points on one line"),
    "integers.tif": (tiff(Z.astype(np.uint16)), "holds integers .uint16., not heights"),
    "colour.tif": (tiff(np.zeros((8, 8, 3), np.uint8), photometric="rgb"), "is a colour picture, not heights"),
    "png.tif": (png(), "cannot be read as TIFF"),
    "other.npz": (npz(a=Z), "is not a height map"),
    "text.npz": (b"hello", "cannot be read as .npz"),
    # nothing
    "nothing.csv": (b"# only words\n", "holds no points"),
    "nothing.gsf": (b"", "is empty: copy it again"),
    **{
        f"blind{e}": (blind(e), "contains no heights") for e in (".npz", ".gwy", ".x3p", ".gsf", ".tif", ".ply", ".pcd")
    },
}


@pytest.mark.parametrize("name", FAULTS)
def test_one_sentence_names_the_file_the_thing_and_the_mend(tmp_path, name):
    content, says = FAULTS[name]
    path = tmp_path / name
    content = content(path) if callable(content) else content
    path.write_bytes(content)
    with pytest.raises(DatasetError, match=says) as fault:
        read_surface(path)
    assert name in str(fault.value)
    assert str(fault.value).count(". ") == 0
    assert str(fault.value).endswith(".")


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("ending", [e for e in READ if e in WRITTEN and e != ".tiff"])
def test_whatever_is_damaged_ends_in_one_sentence(tmp_path, ending):
    """Cut off, or a few bytes changed, anywhere: a sentence, or a surface where nothing that counts was hit."""
    good, path = written(tmp_path / "a", ending), tmp_path / f"a{ending}"
    rng = np.random.default_rng(7)
    for _ in range(30):
        content = bytearray(good[: rng.integers(len(good))] if rng.random() < 0.5 else good)
        for at in rng.integers(0, max(1, min(len(content), 2000)), 4):
            content[at : at + 1] = bytes([rng.integers(256)])
        path.write_bytes(content)
        with contextlib.suppress(DatasetError):
            assert read_surface(path).z_um.ndim == 2


def test_a_file_that_is_not_there_and_one_of_no_known_kind(tmp_path):
    with pytest.raises(DatasetError, match=r"a\.x3p does not exist: check the path"):
        read_surface(tmp_path / "a.x3p")
    with pytest.raises(DatasetError, match=r"a\.png has no ending of a surface file: give one of \.npz, \.gwy"):
        read_surface(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("says", "sentence"),
    [
        ({"z_unit": "mm"}, "states heights in m, but --z-unit is mm: leave --z-unit out"),
        ({"pixel_um": 2.0}, "states pixels of 1 um, but --pixel-um is 2: leave --pixel-um out"),
        ({"z_unit": "ells"}, "gives --z-unit in 'ells', which is not a unit of length"),
    ],
)
def test_what_a_person_says_must_not_contradict_the_file(tmp_path, says, sentence):
    (tmp_path / "a.gsf").write_bytes(gsf())
    with pytest.raises(DatasetError, match=sentence):
        read_surface(tmp_path / "a.gsf", **says)


def test_z_that_points_down_is_turned_over_when_a_person_says_so(tmp_path):
    path = tmp_path / "a.x3p"
    path.write_bytes(in_main(rb"(<CZ>.*?<Increment>)1.0", rb"\g<1>-1.0")(path))
    np.testing.assert_array_equal(read_surface(path, invert_z=True).z_um, make_surface().z_um)


def test_what_a_file_does_not_say_a_person_gives(tmp_path):
    (tmp_path / "a.gsf").write_bytes(gsf(XYUnits=None, ZUnits=None))
    back = read_surface(tmp_path / "a.gsf", z_unit="nm", pixel_um=0.25)
    assert back.pixel_um == 0.25
    np.testing.assert_allclose(back.z_um, Z / 1000)
    assert back.provenance.calibration is None
