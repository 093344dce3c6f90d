"""What is installed may be used: every licence is on a list, and that of the package itself is not narrowed by any."""

from __future__ import annotations

import importlib.metadata
import re
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

from tests.licences import EXCHANGEABLE, OF_NAMED, RUN_TIME, installed, not_allowed, stated
from tests.support.paths import ROOT

PINNED = re.compile(r"^([\w.-]+)==(\S+)", re.MULTILINE)


def pinned(file: Path) -> dict[str, str]:
    return {canonicalize_name(name): version for name, version in PINNED.findall(file.read_text())}


def test_what_runs_with_the_package_has_a_permissive_licence() -> None:
    wrong = {name: bad for name in installed() if (bad := not_allowed(stated(name), RUN_TIME))}
    assert {name: ["LGPL-2.1-or-later"] for name in installed() & EXCHANGEABLE.keys()} == wrong
    assert not installed() & OF_NAMED.keys()
    assert len(installed()) > 30


def test_what_the_tests_run_with_has_a_known_licence() -> None:
    allowed = RUN_TIME | set(OF_NAMED.values()) | {"LGPL-2.1-or-later"}
    wrong = {name: bad for name in installed(extras=("dev",)) if (bad := not_allowed(stated(name), allowed))}
    assert wrong == {}


@pytest.mark.parametrize(
    ("expression", "bad"),
    [
        ("MIT", []),
        ("GPL-3.0-only", ["GPL-3.0-only"]),
        ("MIT OR GPL-3.0-only", []),
        ("BSD-3-Clause AND GPL-2.0-or-later", ["GPL-2.0-or-later"]),
        ("(MIT AND Zlib) OR AGPL-3.0-only", []),
        ("none stated", ["none stated"]),
        ("Apache-2.0 WITH LLVM-exception AND MIT", []),
    ],
)
def test_an_expression_is_read_as_it_means(expression: str, bad: list[str]) -> None:
    assert not_allowed(expression, RUN_TIME) == bad


def test_the_lock_holds_every_package_by_hash() -> None:
    text = (ROOT / "tests/lock.txt").read_text() + (ROOT / "tests/lock_alone.txt").read_text()
    blocks = re.split(r"(?<!\\)\n", "\n".join(line for line in text.splitlines() if not line.startswith("#")))
    assert len(blocks) > 150
    assert not [block for block in blocks if block and "--hash=sha256:" not in block]


def test_the_lock_leaves_nothing_out() -> None:
    locked, here = pinned(ROOT / "tests/lock.txt"), installed(extras=("dev",))
    others = [name for name in here & locked.keys() if importlib.metadata.version(name) != locked[name]]
    if others:
        pytest.skip(f"other versions than the locked ones are installed here, such as that of {others[0]}")
    assert here <= locked.keys()


def test_the_constraints_for_users_are_versions_of_the_lock() -> None:
    constraints, locked = pinned(ROOT / "assets/constraints.txt"), pinned(ROOT / "tests/lock.txt")
    assert constraints.items() <= locked.items()
    assert installed() <= constraints.keys()
