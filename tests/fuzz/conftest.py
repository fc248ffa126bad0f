import importlib

import pytest


@pytest.fixture(scope="session")
def imported():
    """Imports the packages that the first command takes seconds to import."""
    for name in ("bounce", "drift", "optimize", "patrol", "record", "robot", "sweep.tasks"):
        importlib.import_module(f"jaxcell.{name}")
