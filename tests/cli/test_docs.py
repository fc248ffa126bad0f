import webbrowser

import pytest

from jaxcell.cli import docs, main


@pytest.mark.parametrize("display", [True, False])
def test_the_first_documentation_that_exists_is_opened(monkeypatch, tmp_path, capsys, display):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(docs, "has_display", lambda: display)
    site, package = tmp_path / "site.html", tmp_path / "package.html"
    monkeypatch.setattr(docs, "BUILT", (site, package))
    assert main(["docs"]) == 2
    assert "in a checkout `make docs` builds it" in capsys.readouterr().err
    for page in (package, site):
        page.write_text("")
        assert main(["docs"]) == 0
        assert capsys.readouterr().out.split() == [page.as_uri()]
    assert opened == [package.as_uri(), site.as_uri()] * display
