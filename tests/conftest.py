"""For the whole test run: nothing may leave this machine."""

from __future__ import annotations

import gc
import ipaddress
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

gc.disable()  # until all tests are collected

# the same examples every time: a failure can be repeated, a success means the same everywhere
settings.register_profile("clacad", derandomize=True, deadline=None)
settings.load_profile("clacad")

# forecasts rest on nothing that ran here before, and tests leave nothing in the user's cache
os.environ["CLACAD_CACHE_DIR"] = ""

# two workers on two cores: threads of BLAS for small matrices cost several times what they compute
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # started in the background by a shell that ignores Ctrl-C for its jobs; programs under test would inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)


COMPILED = ("tracing", "effects", "hard", "verification", "rendering", "report", "compat")
SOURCES = "tests of the package's sources"
CLOSED_FORM = (
    SOURCES,
    "base",
    "optics",
    "sheet",
    "config",
    "design",
    "scene",
    "explain",
)
OF_SOURCES = (
    "cli/test_registry.py",
    "design/test_keys.py",
    "effects/test_registry.py",
    "exporting/test_format_registry.py",
    "test_house.py",
    "test_language.py",
    "test_layers.py",
    "test_package.py",
    "verification/test_check_kinds.py",
)
"""Tests that parse the whole package: one worker runs them all."""


def mark_by_case(item: pytest.Item, case: str, number: int) -> None:
    """Mark a case as slow or long that its test does not name among those to run; `number`: its place in the family."""
    slow = (
        bool(item.get_closest_marker("slow"))
        or any(case not in mark.args for mark in item.iter_markers("daily_cases"))
        or any(number % mark.args[0] for mark in item.iter_markers("daily_share"))
    )
    by_hand = slow and any(case not in mark.args for mark in item.iter_markers("ci_cases"))
    if by_hand or item.get_closest_marker("long"):
        item.own_markers = [mark for mark in item.own_markers if mark.name != "slow"]
        item.add_marker(pytest.mark.long)
        if by_hand:
            item.add_marker(pytest.mark.like)
    elif slow:
        item.add_marker(pytest.mark.slow)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is slow.

    A heavy family of cases states at its test which cases run by default (`daily_cases`, or every n-th by `daily_share`)
    and which slow ones continuous integration runs (`ci_cases`); the other cases are slow, or long.
    """
    cases: dict[str, set[str]] = {}
    for item in items:
        test, _, case = item.nodeid.removesuffix("]").partition("[")
        family = cases.setdefault(test, set())
        mark_by_case(item, case, len(family))
        family.add(case)
    if not any("::" in argument for argument in config.args):
        for item in items:
            test = item.nodeid.partition("[")[0]
            for mark in (*item.iter_markers("daily_cases"), *item.iter_markers("ci_cases")):
                if unknown := set(mark.args) - cases[test]:
                    raise pytest.UsageError(f"{test} names cases that do not exist: {sorted(unknown)}")


def in_order(items: list[pytest.Item], room: Callable[[pytest.Item], str]) -> list[pytest.Item]:
    """Tests that compile kernels first; those that compile nothing begin in the middle.

    Two workers begin with one half each: the first compiles the kernels, the other finds them compiled when it gets
    there. Began both with tests of kernels, both would compile them.
    """
    ranked = sorted(items, key=lambda item: room(item) not in COMPILED)
    others = [item for item in ranked if room(item) not in CLOSED_FORM]
    middle = min(len(items) // 2, len(others))
    closed = [item for item in ranked if room(item) in CLOSED_FORM]
    closed.sort(key=lambda item: room(item) != SOURCES)
    return [*others[:middle], *closed, *others[middle:]]


def room_of(item: pytest.Item) -> str:
    """First part of the path of a test; those that parse the whole package are one room."""
    path = item.path.relative_to(Path(__file__).parent)
    return SOURCES if path.as_posix() in OF_SOURCES else path.parts[0]


class Order:
    """Order the tests that are left after others were deselected."""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = in_order(items, room_of)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Order())


def pytest_collection_finish() -> None:
    """Collect garbage from here on, never among modules and tests that stay: a third of the time of collection."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def _nothing_loaded() -> None:
    """Let the size of a trace choose its path, as in a fresh process, regardless of what ran before: the same bits every time."""
    paths = sys.modules.get("clacad.tracing.which_path")
    if paths is not None:
        paths.LOADED.clear()
        paths.WAITED.clear()
        paths.MEASURED.clear()


class NetworkUsed(Exception):
    """Something wanted to talk to another machine."""


def _local(address: Any) -> bool:
    """Unix sockets, and this machine's own numbers: test tools may use those among themselves."""
    if not isinstance(address, tuple):
        return True
    host = str(address[0])
    if host in ("", "localhost"):
        return True
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return False


@pytest.fixture(scope="session", autouse=True)
def _no_network_for_children(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Refuse the same to every Python that a test starts, and theirs; what was tried anywhere fails the run."""
    log, watch = str(tmp_path_factory.mktemp("network") / "tried"), str(Path(__file__).parent / "offline")
    begin = subprocess.Popen.__init__

    def watched(self: Any, *arguments: Any, env: Mapping[str, str] | None = None, **options: Any) -> None:
        """Start a child whose environment was made by hand: what it lacks of ours is added."""
        if env is not None:
            path = [entry for entry in (env.get("PYTHONPATH"), watch) if entry]
            env = {"CLACAD_NETWORK_LOG": log, **env, "PYTHONPATH": os.pathsep.join(path)}
        begin(self, *arguments, env=env, **options)

    patch = pytest.MonkeyPatch()
    patch.setenv("CLACAD_NETWORK_LOG", log)
    patch.setenv("PYTHONPATH", watch, prepend=os.pathsep)
    patch.setattr(subprocess.Popen, "__init__", watched)
    yield
    patch.undo()
    assert not Path(log).exists(), Path(log).read_text()


@pytest.fixture(scope="session", autouse=True)
def _no_network() -> Iterator[None]:
    """Refuse every connection, datagram and name look-up that leads elsewhere."""
    kept = {name: getattr(socket.socket, name) for name in ("connect", "connect_ex", "sendto")}
    look_up = socket.getaddrinfo

    def guarded(name: str) -> Any:
        def call(self: socket.socket, *arguments: Any) -> Any:
            address = arguments[-1]
            if self.family != getattr(socket, "AF_UNIX", None) and not _local(address):
                raise NetworkUsed(f"{name} {address}")
            return kept[name](self, *arguments)

        return call

    def looked_up(host: Any, *arguments: Any, **options: Any) -> Any:
        if host is not None and not _local((host,)):
            raise NetworkUsed(f"look-up of {host}")
        return look_up(host, *arguments, **options)

    patch = pytest.MonkeyPatch()
    for name in kept:
        patch.setattr(socket.socket, name, guarded(name))
    patch.setattr(socket, "getaddrinfo", looked_up)
    yield
    patch.undo()
