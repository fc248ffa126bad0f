import importlib.metadata
import webbrowser
from email.message import Message

import pytest

from jaxcell.cli import docs, main


@pytest.fixture
def opened(monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(docs, "has_display", lambda: True)
    return opened


def test_documentation_built_in_a_checkout_is_opened(opened, tmp_path, monkeypatch, capsys):
    built = tmp_path / "index.html"
    built.write_text("")
    monkeypatch.setattr(docs, "BUILT", built)
    assert main(["docs"]) == 0
    assert opened == [built.as_uri()] == capsys.readouterr().out.split()


def test_without_a_build_the_address_of_the_package_is_opened(
    opened, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(docs, "BUILT", tmp_path / "index.html")
    about = Message()
    monkeypatch.setattr(importlib.metadata, "metadata", lambda _: about)
    assert main(["docs"]) == 2
    assert "in a checkout `make docs` builds it" in capsys.readouterr().err
    about["Project-URL"] = "Source, https://example.org/source"
    about["Project-URL"] = "Documentation, https://example.org/docs"
    monkeypatch.setattr(docs, "has_display", lambda: False)
    assert main(["docs"]) == 0
    assert capsys.readouterr().out.split() == ["https://example.org/docs"]
    assert opened == []
