import importlib

import pytest


@pytest.fixture(scope="session")
def imported():
    """What a first command takes seconds to import is imported."""
    for name in ("bounce", "drift", "optimize", "patrol", "record", "robot", "sweep.tasks"):
        importlib.import_module(f"jaxcell.{name}")
