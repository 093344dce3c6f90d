"""What all tests share."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from markupsafe import Markup

from tests.support.campaigns import COMPLETE, SHARE, draw, drawn, examples, runs_always
from tests.support.durations import RENEWS, recorded, renew
from tests.support.patience import PATIENCE_S

# Started in the background a shell lets its children ignore ctrl-C, and theirs inherit that: the programs under test
# are to hear it however the tests were started.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

CAMERAS = "tests/rigs/cameras/"

took: Counter[str] = Counter()
"""Seconds by file."""


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    took[report.nodeid.partition("::")[0]] += report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    if RENEWS and not hasattr(session.config, "workerinput"):
        renew(took)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if getattr(getattr(item, "function", None), "is_hypothesis_test", False):
            item.add_marker(pytest.mark.campaign(within=True))
        if not runs_always(item):
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: -recorded().get(item.nodeid.partition("::")[0], 0.0))
    now = drawn(items)
    if skipped := [item for item in items if item not in now]:
        config.hook.pytest_deselected(items=skipped)
        items[:] = [item for item in items if item in now]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Send the files about cameras to one worker: the simulated GigE camera is there once, and they wait for it."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class LoadDeviceScheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return CAMERAS if nodeid.startswith(CAMERAS) else super()._split_scope(nodeid)

    return LoadDeviceScheduling(config, log)


def pytest_report_header() -> str:
    return "campaigns: complete" if COMPLETE else f"campaigns: one case in {SHARE}, drawn by {draw()[:12]}"


# How long an example takes tells of the machine and of what else it does.
settings.register_profile("campaign", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("tenth", settings.get_profile("campaign"), max_examples=examples(100))
settings.load_profile("campaign" if COMPLETE else "tenth")


@pytest.fixture(scope="session", autouse=True)
def no_markup_in_f_strings() -> Iterator[None]:
    """Markup in an f-string raises: it would become plain text, and be escaped where it enters the page."""

    def refuse(markup: Markup, spec: str) -> str:
        raise TypeError(f"Write Markup(...).format(...) instead of an f-string: {str(markup)[:80]!r} lost its type.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Markup, "__format__", refuse)
        yield


@pytest.fixture(scope="module")
def quick_passwords() -> Iterator[None]:
    """Hashes of passwords cost next to nothing: what they cost is for tests about that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wafer_viewer.session.core.private_file._LOG2_COST", 4)
        yield


@pytest.fixture(scope="session")
def patience_s() -> float:
    return PATIENCE_S
