import pytest


@pytest.fixture(autouse=True)
def _slow_machines_say_no_more(monkeypatch):
    """What a command says does not hang on how long it takes."""
    monkeypatch.setattr("jaxcell.cli.terminal._PATIENCE", 1e6)
