import jaxtyping
import pytest


@pytest.fixture
def unchecked():
    """Types are not checked, where that takes longer than the test and others check the same."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
