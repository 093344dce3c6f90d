"""The examples of the README and of each page that it links run as they stand, in an empty folder."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import tomllib
from pathlib import Path
from textwrap import dedent

import pytest
import yaml

import wafer_viewer
from tests.support.command_line import viewer
from tests.support.paths import ROOT
from tests.support.prose import sentences
from wafer_viewer.rigs.virtual.scenes.wafer import DEPTH_UM

BLOCK = re.compile(r"^( *)```(console|python)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
"""A block of code, in a numbered list too."""

LINK = re.compile(r"\]\(([^):]+)\)")
MOST_WORDS = 700
DOCUMENTATION = ROOT / "assets/docs"
CONTRIBUTING, CHANGELOG = ROOT / ".github/CONTRIBUTING.md", ROOT / ".github/CHANGELOG.md"


def linked(page: Path) -> list[Path]:
    """The pages that a page links, in their order."""
    links = dict.fromkeys(link.partition("#")[0] for link in LINK.findall(page.read_text()))
    found = [(page.parent / link).resolve() for link in links if link.endswith(".md")]
    return [page for page in found if page.exists()]


def pages() -> list[Path]:
    """The README and every page that can be reached from it, in the order in which a reader comes to them."""
    found = [ROOT / "README.md"]
    for page in found:
        found += [link for link in linked(page) if link not in found]
    return found


def examples(page: Path) -> list[tuple[str, str]]:
    return [(kind, dedent(body)) for _, kind, body in BLOCK.findall(page.read_text())]


def test_the_readme_is_short_and_every_page_is_linked():
    assert len((ROOT / "README.md").read_text().split()) <= MOST_WORDS
    of_github = [ROOT / ".github" / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")]
    assert sorted(pages()) == sorted([ROOT / "README.md", *of_github, *DOCUMENTATION.rglob("*.md")])


def test_each_folder_has_an_index_that_lists_all_of_its_pages():
    folders = sorted({page.parent for page in DOCUMENTATION.rglob("*.md")} - {DOCUMENTATION})
    assert [folder.name for folder in folders] == ["explanation", "how-to", "reference", "tutorials", "validation"]
    for folder in folders:
        index = folder / "index.md"
        assert sorted(linked(index), key=str)
        missing = {page for page in folder.glob("*.md") if page != index} - set(linked(index))
        assert not missing, f"{index} does not link {missing}"


WORDS_OF_A_SENTENCE = 25
MOST_LONG_SENTENCES = 9
"""Of all pages together; lower it when some were split, never raise it for a new one."""
MADE_BY_PROGRAM = ("glossary.md", "campaigns.md", "paper.md")


def test_a_page_begins_with_what_it_is_for_and_ends_with_what_to_do_next():
    for page in DOCUMENTATION.rglob("*.md"):
        if page.name in MADE_BY_PROGRAM:
            continue
        title, first, *_ = page.read_text().split("\n\n")
        assert title.startswith("# "), page
        assert first[0].isalpha() or first[0] in "*[`", f"{page} begins with no sentence"
        assert re.search(r"^## Next\n\n.*\]\(", page.read_text(), re.MULTILINE | re.DOTALL), f"{page} has no next step"


def test_hardly_any_sentence_is_long():
    texts = (page.read_text() for page in (ROOT / "README.md", *DOCUMENTATION.rglob("*.md")))
    long = [one for text in texts for one in sentences(text) if len(one.split()) > WORDS_OF_A_SENTENCE]
    assert len(long) <= MOST_LONG_SENTENCES, "\n".join(long)


def test_sentences_are_counted_as_people_read_them():
    page = (
        "# Title\n\nOne *thing*. **Bold.** Another `a b c` of [two words](there.md); no more.\n\n```\ncode. Code\n```\n"
    )
    assert sentences(page) == ["Title", "One *thing*.", "**Bold.", "Another CODE of two words; no more."]


def test_the_list_of_the_api_has_every_public_name_once():
    public = re.findall(r" as (\w+)$", (ROOT / "wafer_viewer/__init__.pyi").read_text(), re.MULTILINE)
    listed = re.findall(r"^   (\w+)$", (DOCUMENTATION / "reference/api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(set(public) - {"__version__"})


def test_every_link_of_the_documentation_leads_to_a_file():
    for page in pages():
        paths = [link.partition("#")[0] for link in LINK.findall(page.read_text())]
        broken = [path for path in paths if path and not (page.parent / path).exists()]
        assert not broken, f"{page}: {broken}"


def test_every_path_that_the_documentation_names_is_there():
    named = re.compile(r"`((?:wafer_viewer|tests|assets)/[\w./-]+)`")
    for page in pages():
        missing = [path for path in named.findall(page.read_text()) if not (ROOT / path).exists()]
        assert not missing, f"{page}: {missing}"


def test_the_page_on_extending_names_files_of_the_package():
    text = (ROOT / "assets/docs/how-to/extend.md").read_text()
    paths = [path for path in re.findall(r"`(\w+/[\w./]+\.py)`", text) if not path.startswith(("assets/", "tests/"))]
    assert len(paths) >= 12
    assert not [path for path in paths if not (ROOT / "wafer_viewer" / path).exists()]


def test_contributors_are_told_every_part_of_the_checks():
    parts = set(re.findall(r"^#   bash tests/run\.sh( \w+)?", (ROOT / "tests/run.sh").read_text(), re.MULTILINE))
    assert len(parts) >= 6
    assert set(re.findall(r"`?bash tests/run\.sh( \w+)?[`\n]", CONTRIBUTING.read_text())) == parts


@pytest.mark.parametrize(
    ("file", "part"),
    [(".github/workflows/checks.yml", "bash tests/run.sh\n"), (".pre-commit-config.yaml", "bash tests/run.sh lint\n")],
)
def test_workflow_and_hooks_run_the_script_of_the_checks(file, part):
    assert yaml.safe_load((ROOT / file).read_text())
    assert part in (ROOT / file).read_text()


def commands(body: str) -> list[list[str]]:
    lines = body.replace("\\\n", " ").splitlines()
    return [shlex.split(line[2:], comments=True) for line in lines if line.startswith("$ ")]


def run_example(kind: str, body: str) -> int:
    """Run a block of code in the working directory and return how many programs it has."""
    if kind == "python":
        Path("example.py").write_text(body)
        runpy.run_path("example.py")
        return 1
    for program, *words in commands(body):
        assert program == "wafer-viewer"
        done = viewer(*words)
        assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
        if words[:3] == ["measure", "step", "scan.wafer"]:
            print(done.stdout)
    return len(commands(body))


def printed_steps(text: str) -> list[tuple[float, float]]:
    """Return the steps of the virtual wafer that examples print, with their U, in um."""
    of_python = re.findall(r"^(\d+\.\d+) ± (\d+\.\d+) um", text, re.MULTILINE)
    of_command = re.findall(r'"height": \{\s*"value_um": ([\d.]+),\s*"expanded_um": ([\d.]+)', text)
    return [(float(height), float(u)) for height, u in (*of_python, *of_command)]


@pytest.fixture(scope="module")
def wafer(tmp_path_factory):
    """The scan of the README, which other pages go on with."""
    folder = tmp_path_factory.mktemp("readme")
    done = viewer("scan", ROOT / "assets/plans/wafer.toml", "-o", folder / "scan.wafer")
    assert done.returncode == 0, done.stderr
    return folder / "scan.wafer"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory of a reader of the documentation."""
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    monkeypatch.chdir(tmp_path)
    return tmp_path


HARDLY_EVER = 1.5
"""Errors over U = 2 u of one scan in several hundred; U itself leaves out one in twenty."""


@pytest.mark.slow
def test_every_example_of_the_readme_runs(folder, capsys):
    assert sum(run_example(kind, body) for kind, body in examples(ROOT / "README.md")) == 3
    ((height, u),) = printed_steps(capsys.readouterr().out)
    assert abs(height - DEPTH_UM) <= HARDLY_EVER * u


PAGES_WITH_EXAMPLES = [page for page in pages()[1:] if examples(page)]
STEPS = {"command-line.md": 1, "python.md": 1}
"""Steps of the virtual wafer that the examples of a page print."""


def test_the_documentation_has_its_examples():
    assert len(PAGES_WITH_EXAMPLES) >= 8
    assert {page.name for page in PAGES_WITH_EXAMPLES} >= set(STEPS)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("page", PAGES_WITH_EXAMPLES, ids=lambda page: page.stem)
def test_every_example_of_a_page_runs(page, folder, request, capsys):
    if "scan.wafer" in page.read_text():
        shutil.copytree(request.getfixturevalue("wafer"), folder / "scan.wafer")
    assert sum(run_example(kind, body) for kind, body in examples(page)) >= 1
    steps = printed_steps(capsys.readouterr().out)
    assert len(steps) == STEPS.get(page.name, 0)
    assert not [(height, u) for height, u in steps if abs(height - DEPTH_UM) > HARDLY_EVER * u]


@pytest.mark.slow
@pytest.mark.campaign
def test_u_of_the_readme_covers_the_truth_in_four_of_five_scans(folder, capsys):
    """The noise of the virtual rig is new in every scan."""
    found = []
    for _ in range(5):
        for kind, body in examples(ROOT / "README.md"):
            run_example(kind, body)
        shutil.rmtree("scan.wafer")
        found += printed_steps(capsys.readouterr().out)
    ratios = [abs(height - DEPTH_UM) / u for height, u in found]
    assert len(ratios) == 5
    assert sorted(ratios)[3] <= 1
    assert max(ratios) <= HARDLY_EVER
    assert max(u for _, u in found) <= 0.3


def test_files_of_a_release_name_the_version_of_the_package():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert version == wafer_viewer.__version__
    assert yaml.safe_load((ROOT / ".github/CITATION.cff").read_text())["version"] == version
    assert re.search(rf"^## {re.escape(version)} \(\d{{4}}-\d\d-\d\d\)$", CHANGELOG.read_text(), re.MULTILINE)
    copied = re.findall(r"^COPY (.+) \S+$", (ROOT / ".github/Containerfile").read_text(), re.MULTILINE)
    assert not [path for line in copied for path in line.split() if not (ROOT / path).exists()]
