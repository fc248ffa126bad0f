"""Run every block of code and every command of README and the pages of the site."""

import ast
import contextlib
import re
import runpy
import shlex
from dataclasses import dataclass
from pathlib import Path

import jax
import pytest
from documented import SUBSTITUTES, substitute

from jaxcell.cli import app, main


ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
INCLUDED = re.compile(r'^--8<-- "([^":]+)"$', re.MULTILINE)
GALLERY = ROOT / "docs" / "pages" / "gallery.md"
# Pictures of recordings; the one of plots is made without a command.
SHOWN = re.findall(r"\(pictures/(?!plots\b)(\w+)\.png", GALLERY.read_text(encoding="utf-8"))
# The sections of these pages are independent, and take seconds.
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
    """The lines of a block of commands, without comments."""
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
            assert before in ("python", "sh"), "a block of text is the output of the code above"
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
                assert line.startswith("pip install ")


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith(("pictures/", "../pictures/")):
            assert (ROOT / "data" / "pictures" / Path(link).name).exists(), link
        else:
            # The site makes pages from notebooks.
            if not (page.parent / link).exists():
                link = re.sub(r"(tutorials/.*)\.md$", r"\1.ipynb", link)
            assert (page.parent / link).exists(), link


@pytest.fixture
def as_users_have_it(tmp_path, monkeypatch, few_drifters):
    """An empty folder, a terminal of 80 columns, JAX with its usual promotions, and few cells."""
    monkeypatch.setenv("COLUMNS", "80")
    # The folder of calibrations of robots.
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxcell.bounce.slip.fine_cells.MAX_CELLS", 3000)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@contextlib.contextmanager
def without_flags():
    """JAX uses 32 bits, as in the program of a user who sets nothing; a command turns on 64."""
    jax.config.update("jax_enable_x64", False)
    try:
        yield
    finally:
        jax.config.update("jax_enable_x64", True)


def do(line):
    """Run a command or its substitute; emulated robots run fast."""
    if (instead := substitute(line)) is not None:
        instead(line)
        return
    name, *words = shlex.split(line)
    assert name == "jaxcell", f"{line}: no test runs it; add a substitute to tests/documented.py"
    fast = "--simulate" in words and "--speedup" not in words
    assert main(words + ["--speedup", "1000"] * fast) == 0, line


def run(section, capsys):
    """Run the blocks of a section in order."""
    names, printed, before = {}, "", ""
    for block in section:
        if block.title:
            Path(block.title).write_text(block.body)
        elif block.language == "python":
            with without_flags():
                exec(block.body, names)
            printed = capsys.readouterr().out
            assert printed
        elif block.language == "text":
            if before == "python":
                assert printed == block.body
            else:
                check_lines(printed, block.body)
        else:
            for line in commands(block):
                do(line)
            printed = capsys.readouterr().out
        before = block.language


def test_each_substitute_stands_for_a_line_of_a_page():
    lines = [
        line
        for page in PAGES
        for block in blocks(page)
        if block.language == "sh"
        for line in commands(block)
    ]
    assert {run for line in lines if (run := substitute(line))} == set(SUBSTITUTES.values())
    assert all(any(text in line for line in lines) for text in SUBSTITUTES)


def check_lines(printed, shown):
    """Check that a command printed the lines of a page; `...` stands for any lines."""
    rest = [line.rstrip() for line in printed.splitlines()]
    after_gap = False
    for line in shown.splitlines():
        assert line == "..." or line in rest, line
        if line != "...":
            assert after_gap or rest[0] == line
            rest = rest[rest.index(line) + 1 :]
        after_gap = line == "..."
    assert after_gap or not rest


def test_lines_of_a_page_are_those_of_its_command():
    check_lines("a\nb\nc \n", "a\n...\nc\n")
    for wrong in ("a\nc\n", "a\nb\n", "c\n...\na\n", "...\nd\n"):
        with pytest.raises(AssertionError):
            check_lines("a\nb\nc\n", wrong)


@pytest.mark.usefixtures("as_users_have_it", "patient")
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
def test_sections_run_as_written(section, capsys):
    run(section, capsys)


@pytest.fixture(scope="module")
def pictures():
    """The commands and recordings of the pictures of the gallery, by name."""
    return runpy.run_path(str(ROOT / "data" / "pictures" / "make_pictures.py"))["PICTURES"]


@pytest.mark.usefixtures("as_users_have_it")
@pytest.mark.parametrize("picture", SHOWN)
def test_the_commands_of_a_picture_make_its_recording(pictures, picture):
    for line in pictures[picture].commands:
        do(f"jaxcell {line}")
    assert Path("runs", pictures[picture].recording).exists()


def test_one_place_says_which_tables_of_the_dissertation_agree():
    others = [*ROOT.glob("data/*/README.md"), *ROOT.glob("experiments/**/README.md")]
    claims = {
        page
        for page in [*PAGES, *others]
        for sentence in re.split(r"\.\s|\n\n|\|", page.read_text(encoding="utf-8"))
        if re.search(r"Tables? \d\.\d", sentence) and re.search(r"\bagree", sentence)
    }
    assert claims == {ROOT / "experiments" / "README.md"}
    page = (ROOT / "docs" / "pages" / "dissertation.md").read_text(encoding="utf-8")
    for part in ("summary", "figures"):
        assert f'--8<-- "experiments/README.md:{part}"' in page


def test_readme_is_short():
    assert len(README.read_bytes()) <= 8000


def test_the_gallery_has_the_commands_of_its_pictures(pictures):
    shown = {line for block in blocks(GALLERY) for line in commands(block)}
    assert {f"jaxcell {line}" for one in pictures.values() for line in one.commands} == shown
    assert set(SHOWN) == set(pictures)
