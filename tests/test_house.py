"""The habits of the house that no linter knows."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from graphlib import TopologicalSorter
from itertools import pairwise, takewhile
from pathlib import Path

import pytest

from tests.support.durations import LEAST_S, recorded, renewed
from tests.support.parsed_modules import MODULES, parsed
from tests.support.paths import ROOT

DRAWS_HTML = [m for m in MODULES if {"gui", "charts"} & set(m.relative_to(ROOT).parts)]


def name(module):
    return str(module.relative_to(ROOT))


def test_a_file_has_one_subject():
    assert not [name(module) for module in MODULES if len(module.read_text().splitlines()) > 600]


QUESTIONS = {"What", "How", "Where", "Whether", "When", "Who", "Which", "Why"}
MOST_FILES = 23
MOST_SHARED_NAMES = 10
DEFINED_ONCE = ("Stage", "Field", "Camera", "Frame", "Gate", "Profile")
EXPLAINED_ROOMS = {"numerics", "measure", "acquire", "calibrate", "reconstruct"}
EXPLAINED = [module for module in MODULES if module.relative_to(ROOT).parts[1] in EXPLAINED_ROOMS]


@pytest.mark.slow
def test_a_docstring_begins_with_a_verb_or_a_noun():
    texts = ((name(module), text.split()[0]) for module in MODULES for text in parsed(module).docstrings)
    assert not [(module, first) for module, first in texts if first.rstrip(",.:") in QUESTIONS]


@pytest.mark.slow
def test_a_number_says_what_it_means():
    assert not [
        f"{name(module)}:{node.lineno}"
        for module in EXPLAINED
        for node, below in pairwise([*ast.parse(module.read_text()).body, ast.Pass()])
        if isinstance(node, ast.Assign | ast.AnnAssign) and holds_a_number(node.value) and not is_text(below)
    ]


@pytest.mark.slow
def test_parameters_of_an_algorithm_say_what_they_mean():
    structs = [
        node
        for module in EXPLAINED
        if "Parameters" in (text := module.read_text())
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef) and node.name.endswith("Parameters")
    ]
    fields = [
        (node, ast.unparse(one.target)) for node in structs for one in node.body if isinstance(one, ast.AnnAssign)
    ]
    assert not [f"{node.name}.{name}" for node, name in fields if f"\n{name} : " not in (ast.get_docstring(node) or "")]


def holds_a_number(value: ast.expr | None) -> bool:
    values = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)] if value else []
    return any(isinstance(one, int | float) and not isinstance(one, bool) for one in values)


def is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


@pytest.mark.slow
def test_html_is_written_as_markup():
    """An f-string with a tag would put a value into the page unescaped."""
    parts = (part for module in DRAWS_HTML for text in parsed(module).f_strings for part in text.values)
    literals = [part.value for part in parts if isinstance(part, ast.Constant)]
    assert not [text for text in literals if re.search(r"<[a-zA-Z/!]", text)]
    joins = (call for module in DRAWS_HTML for call in parsed(module).joins)
    plain = [call for call in joins if isinstance(call.func.value, ast.Constant)]
    assert not [ast.unparse(call) for call in plain if "Markup(" in ast.unparse(call.args[0])], "text joins to text"


def test_html_has_no_handlers():
    """The policy of the page refuses them: what an element does is in gui/static/events.js."""
    handler = re.compile(r"[\s\"']on[a-z]+=\\?[\"'{]")
    assert not [(name(module), found) for module in DRAWS_HTML for found in handler.findall(module.read_text())]


def test_a_room_has_no_room_hidden_in_it():
    full = {str(folder): n for folder, n in Counter(module.parent for module in MODULES).items() if n > MOST_FILES}
    assert not full


@pytest.mark.slow
def test_a_public_name_means_one_thing():
    defined = Counter(
        node.name
        for module in MODULES
        for node in ast.parse(module.read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert len([name for name, n in defined.items() if n > 1]) <= MOST_SHARED_NAMES
    assert all(defined[name] == 1 for name in DEFINED_ONCE)


ROOM_OF_PICTURE = re.compile(r"^( +)(\w+)/ +(\S.*)$")


def test_architecture_shows_every_room_with_its_purpose():
    picture = (ROOT / "assets/docs/explanation/architecture.md").read_text().split("```")[1]
    lines, folders, purposes = picture.strip().splitlines(), {0: ROOT / "wafer_viewer"}, {}
    assert lines[0].startswith("wafer_viewer/")
    for line in takewhile(lambda line: line.startswith(" "), lines[1:]):
        if found := ROOM_OF_PICTURE.match(line):
            indent, name, purpose = found.groups()
            folder = folders[len(indent)] = folders[max(depth for depth in folders if depth < len(indent))] / name
            purposes[folder] = purpose
    rooms = {module.parent for module in MODULES} - {ROOT / "wafer_viewer"}
    assert not [str(folder.relative_to(ROOT)) for folder in rooms ^ purposes.keys()], "in one of the two only"
    assert not [folder for folder, purpose in purposes.items() if len(purpose.split()) < 2]


CIRCLES = {("wafer_viewer.rigs.virtual.prerendering", "wafer_viewer.rigs.virtual.rig")}
"""Imports that close a circle and are still to be untied."""


@pytest.mark.slow
def test_imports_make_no_circle_lazy_ones_and_those_for_types_included():
    names = {".".join(module.relative_to(ROOT).with_suffix("").parts) for module in MODULES}
    graph = {name: imported(ROOT / f"{name.replace('.', '/')}.py") & names for name in names}
    for name, known in CIRCLES:
        graph[name].discard(known)
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def imported(module: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(module.read_text())))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def test_importing_the_package_pulls_in_nothing_heavy():
    heavy = ["numba", "viser", "open3d", "zarr", "distributed", "scipy", "trimesh", "tifffile", "skimage", "matplotlib"]
    code = f"import sys, wafer_viewer; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_one_file_imports_open3d():
    """It loads what Open3D links to, and names the mend where that fails."""
    imports = re.compile(r"^\s*(import|from) open3d\b|import_module\([\"']open3d", re.MULTILINE)
    assert [m.name for m in MODULES if imports.search(m.read_text())] == ["open3d_library.py"]


def test_profiles_steps_and_gauge_checks_need_no_compiler():
    tools = "wafer_viewer.measure.tools.profile, wafer_viewer.measure.tools.step_height"
    code = f"import sys, wafer_viewer.measure.gauge.gauge_check, {tools}; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.slow
def test_the_page_and_its_render_process_start_without_what_draws_for_print():
    started = "wafer_viewer.gui.app, wafer_viewer.session.rendering.render_pictures"
    code = f"import sys, {started}; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


ATTACK = re.compile(r"^\| (\d+) \| (.+?) \| (.+?) \| `(tests/[\w/]+\.py)::(\w+)` \|$", re.MULTILINE)


def test_every_attack_of_the_documentation_has_a_test():
    text = (ROOT / "assets/docs/reference/security.md").read_text()
    attacks = ATTACK.findall(text)
    assert [int(number) for number, *_ in attacks] == list(range(1, len(attacks) + 1))
    assert len(attacks) == text.count("`tests/") - 1  # no line escapes the pattern; the house test itself is named too
    assert len(attacks) >= 40
    named = [(file, test) for *_, file, test in attacks]
    assert len({attack for _, attack, *_ in attacks}) == len(set(named)) == len(attacks)
    tests = {
        file: {n.name for n in ast.parse((ROOT / file).read_text()).body if isinstance(n, ast.FunctionDef)}
        for file in {file for file, _ in named}
    }
    assert not [f"{file}::{test}" for file, test in named if test not in tests[file]]


def test_what_needs_the_machine_for_itself_lies_where_the_checks_look_for_it():
    marked = [path for path in (ROOT / "tests").rglob("*.py") if f"mark.{'real_time'}" in path.read_text()]
    assert marked
    assert [path for path in marked if not path.is_relative_to(ROOT / "tests/rigs")] == []
    assert '-m "real_time and not hardware" tests/rigs' in (ROOT / "tests/run.sh").read_text()


def test_recorded_durations_are_of_files_that_are_there():
    assert recorded()
    assert not [file for file in recorded() if not (ROOT / file).is_file()]
    assert min(recorded().values()) >= LEAST_S
    took = {"tests/test_house.py": 9.2, "tests/test_api.py": 0.1}
    before = {"tests/test_api.py": 5.0, "tests/test_readme.py": 60.0, "tests/test_gone.py": 7.0}
    assert list(renewed(before, took).items()) == [("tests/test_readme.py", 60.0), ("tests/test_house.py", 9.2)]
