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
GALLERY = ROOT / "docs" / "pages" / "gallery.md"
SHOWN = re.findall(r"\(pictures/(\w+)\.png", GALLERY.read_text(encoding="utf-8"))
# The sections of these stand by themselves, and take seconds.
LONG = ("create.md", "current.md")


@dataclass
class Block:
    language: str
    title: str
    body: str


def sections(page):
    """The blocks of a page, section by section."""
    text = page.read_text(encoding="utf-8")
    parts = re.split(r"^## ", text, flags=re.MULTILINE) if page.name in LONG else [text]
    return [
        [
            Block(language, title, INCLUDED.sub(lambda name: (ROOT / name[1]).read_text(), body))
            for language, title, body in FENCE.findall(part)
        ]
        for part in parts
    ]


def blocks(page):
    return [block for section in sections(page) for block in section]


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


@pytest.fixture
def as_users_have_it(tmp_path, monkeypatch, few_drifters):
    """An empty folder, and JAX not as strict as in these tests; robots slip among few cells."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxcell.bounce.slip.fine_cells.MAX_CELLS", 3000)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def do(line):
    """Give a command, whose emulated robot nobody watches."""
    words = shlex.split(line)
    assert main(words + ["--speedup", "1000"] * ("--simulate" in words)) == 0, line


def run(section, capsys):
    """Do what the blocks of a section say, from the first to the last."""
    names, printed = {}, ""
    for block in section:
        if block.title:
            Path(block.title).write_text(block.body)
        elif block.language == "python":
            exec(block.body, names)
            printed = capsys.readouterr().out
            assert printed
        elif block.language == "text":
            assert printed == block.body
        else:
            for line in commands(block):
                if line.startswith("jaxcell") and not any(one in line for one in NOT_HERE):
                    do(line.removeprefix("jaxcell"))
            capsys.readouterr()


@pytest.mark.usefixtures("as_users_have_it")
@pytest.mark.parametrize(
    "section",
    [
        pytest.param(section, id=f"{name(page)}-{number}")
        for page in PAGES
        if page != GALLERY
        for number, section in enumerate(sections(page))
        if section
    ],
)
def test_it_does_what_it_says(section, capsys):
    run(section, capsys)


@pytest.fixture(scope="module")
def pictures():
    """How the pictures of the gallery are made, by their names."""
    return runpy.run_path(str(ROOT / "data" / "pictures" / "make_pictures.py"))["PICTURES"]


@pytest.mark.usefixtures("as_users_have_it")
@pytest.mark.parametrize("picture", SHOWN)
def test_the_commands_of_a_picture(pictures, picture):
    for line in pictures[picture].commands:
        do(line)
    assert Path("runs", pictures[picture].recording).exists()


def test_readme_is_short():
    assert len(README.read_bytes()) <= 8000


def test_readme_has_rows_of_the_benchmarks():
    rows = re.findall(r"^(\|.*\|)$", README.read_text(encoding="utf-8"), re.MULTILINE)[2:]
    table = (ROOT / "docs" / "pages" / "benchmarks.md").read_text(encoding="utf-8")
    assert len(rows) == 5
    for row in rows:
        assert row in table


def test_the_gallery_has_the_commands_of_its_pictures(pictures):
    shown = {line for block in blocks(GALLERY) for line in commands(block)}
    assert {f"jaxcell {line}" for one in pictures.values() for line in one.commands} == shown
    assert set(SHOWN) == set(pictures)
