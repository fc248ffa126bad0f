"""Statements of the pages about packages, layers and versions, read from the files themselves."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

from jaxcell import __version__
from jaxcell.cli import main


ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "pages"


def imported(path):
    """The packages of jaxcell that a file imports, also inside functions."""
    own = path.relative_to(ROOT).with_suffix("").parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom):
            continue
        base = [*own[: len(own) - node.level], *(node.module or "").split(".")]
        base = [part for part in base if part] if node.level else (node.module or "").split(".")
        if base[0] == "jaxcell":
            yield from base[1:2] if base[1:] else (alias.name for alias in node.names)


def test_a_package_imports_only_packages_above_it():
    text = (PAGES / "packages.md").read_text(encoding="utf-8")
    order = re.findall(r"^\| \[?`jaxcell\.(\w+)`", text, re.MULTILINE)
    present = {
        path.name.removesuffix(".py")
        for path in (ROOT / "jaxcell").iterdir()
        if (path.is_dir() or path.suffix == ".py") and not path.name.startswith("__")
    }
    assert set(order) == present - {"base", "data"}
    for place, package in enumerate(order):
        folder = ROOT / "jaxcell" / package
        files = [*folder.rglob("*.py")] or [folder.with_suffix(".py")]
        used = {name for file in files for name in imported(file)} & set(order)
        assert used <= set(order[: place + 1]), package


def test_the_table_of_layers_is_that_of_the_linter():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = [set(layer.split(" | ")) for layer in contracts["contracts"][0]["layers"]]
    text = (PAGES / "contributing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| (.*?) \|", text, re.MULTILINE)
    assert [set(re.findall(r"`(\w+)`", packages)) for _, packages in rows] == layers
    assert [int(number) for number, _ in rows] == list(range(len(layers), 0, -1))


def test_a_change_runs_what_contributing_says():
    text = (PAGES / "contributing.md").read_text(encoding="utf-8").split("\n\n")[1]
    runs = re.findall(r"^make ([\w-]+)$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)
    for target in runs:
        assert f"`make {target}`" in text


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_the_version_is_that_of_the_changelog_and_the_citation(capsys, option):
    changelog = (PAGES / "changelog.md").read_text(encoding="utf-8")
    number, state = re.search(r"^## (\S+), (.*)$", changelog, re.MULTILINE).groups()
    assert __version__ == (f"{number}.dev0" if state == "not released yet" else number)
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall("^version: (.*)$", citation, re.MULTILINE) == [__version__]
    assert main([option]) == 0
    assert capsys.readouterr().out == f"jaxcell {__version__}\n"


@pytest.mark.parametrize("words", [["--out", ""], ["--out="]])
def test_an_empty_folder_for_results_is_refused(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    assert main(["groups", "@lab_a", "--bounce", "45", *words]) == 2
    assert capsys.readouterr().err == (
        "jaxcell groups: --out: expected a value, got an empty text\n"
    )
    assert not [*tmp_path.iterdir()]
