"""The site of the documentation: where it is looked for, and what is said when it is not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from wafer_viewer.cli.app import main
from wafer_viewer.gui.shell.shortcuts import documentation_link
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.files import documentation


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "built"
    monkeypatch.setattr(documentation, "BUILT", folder)
    monkeypatch.setattr(documentation, "SHIPPED", tmp_path / "shipped")
    return folder


def write(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)


def test_a_built_site_is_preferred_to_the_shipped_one(built: Path) -> None:
    write(documentation.SHIPPED, "index.html")
    assert documentation.first_page() == documentation.SHIPPED / "index.html"
    write(built, "index.html", "_static/site.css")
    assert documentation.first_page() == built / "index.html"
    assert dict(documentation.documentation_files()) == {
        "index.html": built / "index.html",
        "_static/site.css": built / "_static/site.css",
    }


def test_a_missing_site_is_answered_with_the_way_to_it(built: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert documentation.documentation_files() == {}
    assert main(["docs"]) == 2
    assert "wafer-viewer docs --build" in capsys.readouterr().err
    assert "not built" in documentation_link()
    write(built, "index.html")
    assert 'href="/documentation/index.html"' in documentation_link()


def test_the_command_opens_the_first_page(
    built: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    write(built, "index.html")
    assert main(["docs"]) == 0
    assert opened == [(built / "index.html").as_uri()] == capsys.readouterr().out.split()


def test_a_build_without_sources_or_tools_says_what_is_missing(built: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(documentation, "TOOLS", ("sphinx_of_nobody",))
    with pytest.raises(WaferViewerError, match=r"sphinx_of_nobody .*wafer-viewer\[docs\]"):
        documentation.build_site()
    monkeypatch.setattr(documentation, "SOURCES", built / "none")
    with pytest.raises(WaferViewerError, match="no sources"):
        documentation.build_site()
