import os
import re
import zipfile
from pathlib import Path

import pytest
from helpers import python

from jaxcell import bundled
from jaxcell.base.bundled import bundled_names
from jaxcell.base.paths import name_in_results
from jaxcell.cli import main
from jaxcell.sweep import Spec


ROOT = Path(__file__).parents[2]
ENDS = {".json", ".nc", ".toml", ".txt", ".yaml"}


def test_each_file_has_a_name_of_its_own():
    files = {
        path
        for folder in ("maps", "graphs", "ocean", "sweeps")
        for path in (ROOT / "data" / folder).iterdir()
        if path.suffix in ENDS
    }
    files.add(ROOT / "data/ocean/gdp.npz")
    assert set(bundled_names().values()) == files
    for name, path in bundled_names().items():
        assert bundled(name) == bundled(f"@{name}") == path
    assert bundled("maps/office.pgm").is_file()


def test_a_name_that_is_nearly_one_is_corrected(capsys):
    with pytest.raises(FileNotFoundError, match="did you mean @lab_a"):
        bundled("@lab_aa")
    assert main(["patrol", "map", "@lab_aa"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("jaxcell patrol map: @lab_aa: ")
    assert len(said.splitlines()) == 1


def test_a_name_stands_for_a_file_on_the_command_line(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", "@lab_a", "--json"]) == 0
    assert '"positions": 19' in capsys.readouterr().out


def test_results_name_bundled_data(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert name_in_results(bundled("lab_a")) == "@lab_a"
    monkeypatch.chdir(ROOT)
    assert name_in_results(bundled("lab_a")) == "data/maps/lab_a.json"


def test_specifications_of_sweeps_name_bundled_data():
    spec = Spec.load(bundled("lab_groups"))
    assert spec.find_file("@lab_b") == bundled("lab_b")
    assert spec.find_file("@lab_x") is None


def test_a_wheel_has_them_and_the_pages(tmp_path):
    python("-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=ROOT)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    pages = tmp_path / "site" / "jaxcell" / "data" / "pages"
    for page in pages.rglob("*.html"):
        for link in re.findall(r'(?:href|src)="(?!\w+:|#)([^"#]+)', page.read_text("utf-8")):
            assert (page.parent / link).exists(), f"{page}: {link}"
    (about,) = (tmp_path / "site").glob("*/METADATA")
    assert not re.search(r"\]\((?!\w+:|#)", about.read_text("utf-8")), "links relative to nothing"
    code = (
        "import jaxcell, sys\n"
        "from jaxcell.base.bundled import bundled_names\n"
        "from jaxcell.cli import main\n"
        "assert all(str(path).startswith(sys.argv[1]) for path in bundled_names().values())\n"
        f"assert len(bundled_names()) == {len(bundled_names())}\n"
        "sys.exit(main(['groups', '@lab_a', '--bounce', '90', '--json']))"
    )
    site, elsewhere = str(tmp_path / "site"), tmp_path / "elsewhere"
    elsewhere.mkdir()
    environment = {**os.environ, "PYTHONPATH": site}
    printed, _ = python("-c", code, site, cwd=elsewhere, env=environment)
    assert '"map": "@lab_a"' in printed
    printed, _ = python("-m", "jaxcell", "docs", cwd=elsewhere, env=environment)
    assert printed.split() == [(pages / "index.html").as_uri()]
