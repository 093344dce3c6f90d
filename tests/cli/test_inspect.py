"""`inspect` tells what files hold before they are imported, and what has to be settled."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tifffile

from tests.support.datasets.samples import make_surface
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.conversion import export

N = 14


def frames(order=range(N)):
    """A tilted plane of random texture, blurred by its distance from the focus of each frame."""
    from scipy.ndimage import gaussian_filter

    texture = np.random.default_rng(3).uniform(0, 200, (160, 200))
    z = np.linspace(2, N - 3, 200)
    blurred = np.stack([gaussian_filter(texture, 0.4 + 0.5 * n) for n in range(N)])
    cols = np.arange(200)
    return [blurred[np.abs(np.rint(z) - k).astype(int), :, cols].T.astype(np.uint8) for k in order]


def write(folder, images, name="img_{:03d}.tif"):
    folder.mkdir()
    for k, image in enumerate(images):
        tifffile.imwrite(folder / name.format(k), image)
    return str(folder)


def inspected(capsys, *words):
    status = main(["inspect", *words, "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_a_stack_is_told_with_the_sources_of_its_lengths(tmp_path, capsys):
    path = tmp_path / "a.tif"
    words = {"axes": "ZYX", "spacing": 2.5, "unit": "um"}
    tifffile.imwrite(path, np.stack(frames()), imagej=True, resolution=(2.0, 2.0), metadata=words)
    status, found = inspected(capsys, str(path))
    facts = {fact["name"]: fact for fact in found["facts"]}
    assert status == 0
    assert facts["pixel size"]["value"] == "0.5 um"
    assert facts["z step"]["value"] == "2.5 um"
    assert "ImageJ" in facts["z step"]["source"]
    assert [frame["z_um"] for frame in found["frames"]] == [2.5 * k for k in range(N)]
    assert all(max(frame["sharpness"]) <= 1 for frame in found["frames"])
    assert main(["inspect", str(path)]) == 0
    assert "It can be imported as it is." in capsys.readouterr().out


def test_an_order_that_the_images_contradict_is_a_doubt_and_not_one_without_a_look(tmp_path, capsys):
    src = write(tmp_path / "a", frames([*range(7, N), *range(7)]))
    status, found = inspected(capsys, src, "--z-step-um", "2", "--pixel-um", "1")
    assert status == 1
    assert "contradict the order" in found["doubts"][0]
    status, _ = inspected(capsys, src, "--z-step-um", "2", "--pixel-um", "1", "--quick")
    assert status == 0
    status, _ = inspected(capsys, src, "--z-step-um", "2", "--pixel-um", "1", "--as-listed")
    assert status == 0


def test_a_missing_length_is_told_with_the_facts_there_are(tmp_path, capsys):
    status, found = inspected(capsys, write(tmp_path / "a", frames()))
    assert status == 1
    assert "--z-step-um" in found["doubts"][0]
    assert {"name": "files", "value": str(N), "source": ""} in found["facts"]
    assert len(found["frames"]) == N


def test_every_open_value_is_named_with_the_frames_read_nevertheless(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    for k, image in enumerate(frames()):
        tifffile.imwrite(tmp_path / "a" / f"z{2.5 * k:.1f}um.tif", image)
    status, found = inspected(capsys, str(tmp_path / "a"), "--z-step-um", "3")
    facts = {fact["name"]: fact for fact in found["facts"]}
    assert status == 1
    assert sorted(found["unsettled"]) == ["pixel size", "z step"]
    assert facts["pixel size"]["value"] == ""
    assert facts["z step"]["value"] == "3 um or 2.5 um"
    assert facts["z step"]["source"].startswith("given; names of the files")
    assert len(found["frames"][0]["sharpness"]) == 5
    assert found["field_um"] is None


def test_files_left_out_places_and_size_are_told(tmp_path, capsys):
    src = write(tmp_path / "a", frames())
    (tmp_path / "a" / "fused.tif").write_bytes((tmp_path / "a" / "img_003.tif").read_bytes())
    _, found = inspected(capsys, src, "--z-step-um", "2", "--pixel-um", "0.5", "--quick")
    assert found["left_out"] == ["fused.tif"]
    assert (found["places_um"], found["field_um"]) == ([[0.0, 0.0]], [100.0, 80.0])
    assert found["n_bytes"] == N * 160 * 200


def test_a_missing_frame_keeps_its_place(tmp_path, capsys):
    src = write(tmp_path / "a", frames())
    (tmp_path / "a" / "img_005.tif").unlink()
    status, found = inspected(capsys, src, "--z-step-um", "2", "--pixel-um", "1")
    assert status == 0
    assert (found["frames"][5]["name"], found["frames"][5]["z_um"]) == ("", 10.0)
    assert any("missing" in note for note in found["notes"])


def test_surfaces_are_told_and_what_they_lack_is_a_doubt(tmp_path, capsys):
    part = export(make_surface(), tmp_path / "part.x3p")
    status, found = inspected(capsys, str(part))
    assert (status, found["kind"]) == (0, "surface")
    assert {"pixel size", "heights", "gaps"} <= {fact["name"] for fact in found["facts"]}
    (tmp_path / "bare.csv").write_text("x,y,z\n0,0,1\n1,0,2\n0,1,3\n1,1,4\n")
    status, found = inspected(capsys, str(tmp_path / "bare.csv"))
    assert status == 1
    assert "--z-unit" in found["doubts"][0]


@pytest.mark.parametrize("name", ["a.czi", "a.txt.bak", "nothing.tif"])
def test_what_is_not_read_is_refused_by_its_kind(tmp_path, capsys, name):
    if name != "nothing.tif":
        (tmp_path / name).write_bytes(b"0" * 100)
    assert main(["inspect", str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.startswith("wafer-viewer: ")
