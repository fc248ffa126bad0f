"""What README and the pages of the site say: every block of code runs, and every command."""

import ast
import re
import runpy
import shlex
from dataclasses import dataclass
from pathlib import Path

import jax
import pytest

from jaxcell.cli import app, main


ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
INCLUDED = re.compile(r'^--8<-- "([^":]+)"$', re.MULTILINE)
# What needs a network, a screen, a robot, a cluster or half an hour is read, and not run.
NOT_HERE = ("jaxcell view", "/dev/tty", "dask://", "--live", "jaxcell demo")
SHELL = ("pip install ",)
# What these say takes seconds to do.
LONG = ("gallery.md", "create.md", "current.md", "dynamics.md", "map.md")


@dataclass
class Block:
    language: str
    title: str
    body: str


def blocks(page):
    found = FENCE.findall(page.read_text(encoding="utf-8"))
    return [
        Block(language, title, INCLUDED.sub(lambda name: (ROOT / name[1]).read_text(), body))
        for language, title, body in found
    ]


def commands(block):
    """The lines of a block of commands, without remarks."""
    return [re.sub(r"\s+# .*", "", line) for line in block.body.splitlines()]


def name(page):
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_blocks_are_of_known_kinds(page):
    before = None
    for block in blocks(page):
        if block.title:
            assert Path(block.title).name == block.title
        elif block.language == "text":
            assert before == "python", "text below code is what it prints"
        elif block.language == "python":
            ast.parse(block.body)
        else:
            assert block.language == "sh"
        before = "a file" if block.title else block.language


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_can_be_read(page):
    targets = re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for block in blocks(page):
        for line in commands(block) if block.language == "sh" else []:
            words = shlex.split(line)
            if words[0] == "make":
                assert words[1] in targets
            elif words[0] == "jaxcell":
                assert words[1] == "run" or app.read(words[1:])
            else:
                assert line.startswith(SHELL)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith(("pictures/", "../pictures/")):
            assert (ROOT / "data" / "pictures" / Path(link).name).exists(), link
        else:
            assert (page.parent / link).exists(), link


def run(page, folder, capsys, monkeypatch, with_commands=True):
    """Do what a page says in a folder, from the top to the bottom."""
    monkeypatch.chdir(folder)
    names, printed = {}, ""
    for block in blocks(page):
        if block.title:
            Path(block.title).write_text(block.body)
        elif block.language == "python":
            exec(block.body, names)
            printed = capsys.readouterr().out
            assert printed
        elif block.language == "text":
            assert printed == block.body
        elif with_commands:
            for line in commands(block):
                if line.startswith("jaxcell") and not any(one in line for one in NOT_HERE):
                    assert main(shlex.split(line)[1:]) == 0, line
            capsys.readouterr()


@pytest.fixture
def as_it_comes():
    """JAX as users have it, and not as strict as in these tests."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@pytest.mark.usefixtures("as_it_comes")
def test_the_code_of_readme_works(tmp_path, capsys, monkeypatch):
    run(README, tmp_path, capsys, monkeypatch, with_commands=False)


@pytest.mark.usefixtures("as_it_comes")
@pytest.mark.parametrize(
    "page",
    [pytest.param(one, marks=[pytest.mark.slow] if one.name in LONG else []) for one in PAGES],
    ids=name,
)
def test_it_does_what_it_says(page, tmp_path, capsys, monkeypatch):
    run(page, tmp_path, capsys, monkeypatch)


def test_readme_is_short():
    assert len(README.read_bytes()) <= 8000


def test_readme_has_rows_of_the_benchmarks():
    rows = re.findall(r"^(\|.*\|)$", README.read_text(encoding="utf-8"), re.MULTILINE)[2:]
    table = (ROOT / "docs" / "pages" / "benchmarks.md").read_text(encoding="utf-8")
    assert len(rows) == 5
    for row in rows:
        assert row in table


def test_the_gallery_has_the_commands_of_its_pictures():
    pictures = runpy.run_path(str(ROOT / "data" / "pictures" / "make_pictures.py"))["PICTURES"]
    page = ROOT / "docs" / "pages" / "gallery.md"
    shown = {line for block in blocks(page) for line in commands(block)}
    assert {f"jaxcell {line}" for one in pictures.values() for line in one.commands} == shown
    text = page.read_text(encoding="utf-8")
    assert set(re.findall(r"pictures/(\w+)\.png", text)) == set(pictures)
