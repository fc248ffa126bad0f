import pytest


@pytest.fixture
def filter_file(tmp_path):
    """The filter of Lab A for a bouncing angle of 45 degrees."""
    # Imported late, because most tests of commands need no JAX.
    from robot_files import save_filter

    return save_filter(tmp_path)
