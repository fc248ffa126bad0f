import importlib

import pytest


@pytest.fixture(autouse=True)
def _slow_machines_say_no_more(monkeypatch):
    """What a command says does not hang on how long it takes."""
    monkeypatch.setattr("jaxcell.cli.terminal._PATIENCE", 1e6)


@pytest.fixture(scope="session")
def imported():
    """What a first command takes seconds to import is imported."""
    for name in ("bounce", "drift", "optimize", "patrol", "record", "robot", "sweep.tasks"):
        importlib.import_module(f"jaxcell.{name}")
