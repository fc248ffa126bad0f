import importlib

import pytest


@pytest.fixture(scope="session")
def imported():
    """Import the packages that take seconds at the first command."""
    for name in ("bounce", "drift", "optimize", "patrol", "record", "robot", "sweep.tasks"):
        importlib.import_module(f"jaxcell.{name}")
