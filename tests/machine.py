"""The machine under the tests: DDS domains of their own, what it may lack, and the skips that follow.

A test marked with one of `NEEDS` is skipped where the machine lacks that, and fails there instead if
``SFGLAB_REQUIRE`` names it, as in CI: ``SFGLAB_REQUIRE=netns,browser``. Each skip's reason becomes a line of
the file that ``SFGLAB_SKIPS`` names, so that `make test` can end with the skips of all its runs.
"""

import os
import signal
from contextlib import ExitStack
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

import pytest

REQUIRED = frozenset(filter(None, os.environ.get("SFGLAB_REQUIRE", "").split(",")))


def _lack_of_namespaces() -> str:
    from sfglab.lab.hosts import Network

    return Network.available().reason


def _lack_of_a_browser() -> str:
    missing = [name for name in ("PySide6", "viser", "websockets") if find_spec(name) is None]
    return f"needs a browser: {', '.join(missing)} not installed" if missing else ""


def _lack_of_ros() -> str:
    from sfglab.lab.ros2 import TESTED, RosMissingError, distributions

    missing = [name for name in TESTED if name not in distributions()]
    return str(RosMissingError(missing)) if missing else ""


def _lack_of_zenoh() -> str:
    missing = [name for name in ("zenoh", "xxhash") if find_spec(name) is None]
    return f"needs Zenoh: {', '.join(missing)} not installed" if missing else ""


NEEDS = {
    "netns": cache(_lack_of_namespaces),
    "browser": cache(_lack_of_a_browser),
    "ros": cache(_lack_of_ros),
    "zenoh": cache(_lack_of_zenoh),
}


def hear_signals() -> None:
    """Handle signals as in a terminal.

    A shell ignores them for what it starts in the background, and so would every process that a test
    starts. A command that a test runs in this process may leave the handler of its closed event loop.
    """
    for number, usual in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) is not usual:
            signal.signal(number, usual)


def pytest_configure() -> None:
    import typer.main
    from hypothesis import settings

    # `sfglab` builds the parsers of all its commands, once in a process. Tests call it many times in one.
    typer.main.get_command = cache(typer.main.get_command)
    hear_signals()
    settings.register_profile("any machine", deadline=None)  # a busy one is slow
    settings.load_profile("any machine")
    if unknown := REQUIRED - set(NEEDS):
        given, allowed = ", ".join(sorted(unknown)), ", ".join(NEEDS)
        raise pytest.UsageError(f"SFGLAB_REQUIRE: given {given}, allowed: {allowed}")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put slow tests at the beginning of each worker's share, so that none is left for the end.

    Those that share fixtures of their module stay where they are.
    """
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    slow = [
        item for item in items if item.get_closest_marker("slow") and not _shares_fixtures(item)
    ]
    moved = set(slow)
    rest = [item for item in items if item not in moved]
    bounds = [len(rest) * k // workers for k in range(workers + 1)]
    items[:] = [
        item
        for k in range(workers)
        for item in (*slow[k::workers], *rest[bounds[k] : bounds[k + 1]])
    ]


def _shares_fixtures(item: pytest.Item) -> bool:
    found = getattr(item, "_fixtureinfo").name2fixturedefs.values()  # noqa: B009 - only functions have it
    return any(fixtures[-1].scope in ("module", "class", "package") for fixtures in found)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    hear_signals()
    for need, lack in NEEDS.items():
        if item.get_closest_marker(need) and lack():
            skip(need, lack())


def skip(need: str, reason: str) -> NoReturn:
    """Skip a test whose machine lacks what it needs; fail it where that is required."""
    if need in REQUIRED:
        pytest.fail(f"SFGLAB_REQUIRE asks for {need}: {reason}", pytrace=False)
    pytest.skip(reason)


def open_browser(width: int, height: int):
    """Return a page in a browser; skip the test where its engine does not start."""
    from browser import Browser, BrowserError

    from sfglab.errors import MissingExtraError

    try:
        return Browser(width, height)
    except (MissingExtraError, BrowserError) as error:
        skip("browser", str(error))


def pytest_terminal_summary(terminalreporter, config) -> None:
    skipped = terminalreporter.stats.get("skipped", [])
    file = os.environ.get("SFGLAB_SKIPS")
    if file and not hasattr(
        config, "workerinput"
    ):  # the process that starts workers hears of their skips
        with Path(file).open("a", encoding="utf-8") as kept:
            kept.writelines(
                f"{report.longrepr[2].removeprefix('Skipped: ')}\n" for report in skipped
            )


@pytest.fixture
def free_domains():
    """A function that reserves a number of DDS domains until the test has ended."""
    from sfglab.lab.testbed import held_domains

    with ExitStack() as held:
        yield lambda count: held.enter_context(held_domains(count))


@pytest.fixture
def domain_id(free_domains):
    """A DDS domain that no other test uses."""
    return free_domains(1)[0]
