"""A format that another package brings with one file, the example of the documentation, is found everywhere."""

from __future__ import annotations

import json
import re

import pytest

from tests.support.datasets.samples import make_surface
from tests.support.paths import ROOT
from tests.support.plugin_packages import run_with, write_package
from wafer_viewer.store.formats.conversion import export

PAGE = (ROOT / "assets/docs/how-to/extend.md").read_text()
SECTION = PAGE[PAGE.index("### A surface format") :]
EXAMPLE, ENTRY = (re.search(rf"```{kind}\n(.*?)```", SECTION, re.DOTALL)[1] for kind in ("python", "toml"))
EVERYWHERE = """
import json, sys
from pathlib import Path
import wafer_viewer as wv
from wafer_viewer.gui.dialogs.open_and_export import READ_FILES, WRITTEN_TITLES
from wafer_viewer.session.files.file_browser import FILE_KINDS
from wafer_viewer.store.formats.conversion import losses

folder = Path(sys.argv[1])
surface = wv.read_surface(folder / "a.npz")
back = wv.read_surface(wv.write_surface(surface, folder / "a.grid"))
try:
    wv.export(surface, folder / "a.abc")
except wv.WaferViewerError as fault:
    refusal = str(fault)
print(json.dumps({
    "is_same": bool(((back.z_um == surface.z_um) | (surface.z_um != surface.z_um)).all()),
    "place": [back.pixel_um, back.x0_um, back.y0_um] == [surface.pixel_um, surface.x0_um, surface.y0_um],
    "simulated": back.provenance.simulated,
    "losses": losses(surface, folder / "a.grid"),
    "refusal": refusal,
    "help": [wv.export.__doc__, wv.read_surface.__doc__],
    "exported": WRITTEN_TITLES,
    "opened": READ_FILES,
    "listed": [name for name, kind in FILE_KINDS.items() if ".grid" in kind.endings],
}))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A package with one file, installed; beside it a surface."""
    folder = tmp_path_factory.mktemp("plugins")
    write_package(folder, "grid_format", EXAMPLE, {"surface_formats": ENTRY.splitlines()[1].replace('"', "")})
    export(make_surface(simulated=True), folder / "a.npz")
    return folder


@pytest.mark.slow
def test_the_python_api_the_page_and_the_errors_know_it(installed):
    found = json.loads(run_with(installed, "-W", "error", "-c", EVERYWHERE, str(installed)).stdout)
    assert found["is_same"]
    assert found["place"]
    assert found["simulated"]
    assert found["losses"] == ["It holds heights only."]
    assert found["refusal"].endswith(".glb, .html, .grid.")
    assert all(" .grid``" in text for text in found["help"])
    assert found["exported"]["GRID, heights as text"] == ".grid"
    assert found["opened"].endswith(", .grid")
    assert set(found["listed"]) == {"dataset", "images", "surface"}


@pytest.mark.campaign
def test_the_command_line_exports_and_imports_it(installed):
    def run(*words):
        return run_with(installed, "-m", "wafer_viewer", *(str(word) for word in words))

    done = run("convert", installed / "a.npz", installed / "b.grid")
    assert "b.grid: It holds heights only." in done.stderr
    assert "a surface without frames" in run("import", installed / "b.grid", "-o", installed / "b.wafer").stdout
    assert " .grid; writes" in run("convert", "--help").stdout


def test_it_is_found_though_its_own_module_is_imported_first(installed):
    code = "import grid_format; from wafer_viewer.model.file_formats import READ; print(READ[-1])"
    assert run_with(installed, "-W", "error", "-c", code).stdout.strip() == ".grid"


def test_one_with_the_suffix_of_another_format_is_named_and_left_out(tmp_path):
    source = "from wafer_viewer.model.surface_format import SurfaceFormat\n"
    source += "MINE = SurfaceFormat(suffixes=('.npz',), title='Mine', reader='nowhere:read')\n"
    write_package(tmp_path, "takes_npz", source, {"surface_formats": "mine = takes_npz:MINE"})
    done = run_with(
        tmp_path, "-c", "from wafer_viewer.model.file_formats import BY_SUFFIX; print(BY_SUFFIX['.npz'].title)"
    )
    assert done.stdout.strip() == "NumPy, all layers"
    assert "PluginWarning: The format 'Mine' is left out, .npz is taken: rename it." in done.stderr


@pytest.mark.slow
def test_one_whose_reader_cannot_be_loaded_is_refused_in_one_sentence(tmp_path):
    source = "from wafer_viewer.model.surface_format import SurfaceFormat\n"
    source += "MINE = SurfaceFormat(suffixes=('.mine',), title='Mine', reader='nowhere:read')\n"
    write_package(tmp_path, "reads_nothing", source, {"surface_formats": "mine = reads_nothing:MINE"})
    (tmp_path / "a.mine").write_text("1 2 3")
    done = run_with(tmp_path, "-m", "wafer_viewer", "convert", f"{tmp_path}/a.mine", f"{tmp_path}/a.npz", check=False)
    assert done.returncode == 2
    assert "nowhere:read cannot be loaded (No module named 'nowhere'): update or remove" in done.stderr
