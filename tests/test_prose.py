"""Patterns of English that readers stumble over, in texts of the library, its tests and its pages.

Each folder is a case of its own: `pytest tests/test_prose.py -k "record or drift" --runxfail`.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
# Folders whose texts are still being rewritten; the goal is an empty list.
UNFINISHED = [
    "cli",
]
# A text begins with its verb or its noun, not with a clause that stands for a noun.
_CLAUSE = re.compile(
    r"(?:Whether|How|Why|Who|Whoever|What|Whatever|Those|Where|One (?:of|that|who|whose|which))\b"
)
# A comment may begin with a condition: "Where the robot bumps, it turns."
_CONDITION = re.compile(r"Where\b.*,", re.DOTALL)
_PHRASES = re.compile(
    r"\b(?:anew|for ever|nobody|whoever|quarrel\w*"
    r"|told(?! apart)|so many(?! \w+ that)|if one(?! of)|but for"
    r"|one (?:number|value|row|line|column|colour|entry|array|file|bit|byte) an? (?!time)\w+)\b",
    re.IGNORECASE,
)
_TEST_NAMES = re.compile(r"test_(?:what|whatever|where|whether|how|who|whoever|those|nobody)_")
# Texts that match and are plain all the same.
ALLOWED: list[str] = []


def folders() -> list[str]:
    packages = sorted(path.parent.name for path in ROOT.glob("jaxcell/*/__init__.py"))
    return [*packages, "jaxcell", "tests", "experiments", "data", "pages"]


def files_of(folder: str) -> list[Path]:
    """The files of a package and its tests, or the files of another folder."""
    if folder in ("jaxcell", "tests"):
        known = {ROOT / "tests" / name for name in folders()}
        here = [path for path in ROOT.joinpath(folder).glob("*.py") if path != Path(__file__)]
        others = [path for path in ROOT.glob("tests/*/") if path not in known]
        return here + [file for path in others if folder == "tests" for file in path.rglob("*.py")]
    if folder == "pages":
        return [ROOT / "README.md", *ROOT.glob("docs/pages/**/*.md"), *ROOT.glob("docs/*.py")]
    roots = [ROOT / folder] if folder in ("experiments", "data") else [ROOT / "jaxcell" / folder]
    roots.append(ROOT / "tests" / folder)
    return [
        file for root in roots for file in root.rglob("*.py*") if file.suffix in (".py", ".pyi")
    ]


def comments(source: str) -> Iterator[tuple[int, str]]:
    """Each block of comments, as one text, with the line on which it begins."""
    line, texts = 0, []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            if texts and token.start[0] != line + len(texts):
                yield line, "\n".join(texts)
                texts = []
            line = line if texts else token.start[0]
            texts.append(token.string.removeprefix("#").strip())
    if texts:
        yield line, "\n".join(texts)


def odd_texts(path: Path) -> Iterator[tuple[int, str]]:
    """The line and the odd part of each text of a file."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        for number, text in enumerate(source.splitlines(), 1):
            yield from ((number, match[0]) for match in _PHRASES.finditer(text))
        return
    tree = ast.parse(source)
    docstrings = {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            first_sentence = re.split(r"(?<=[.?:])\s", node.value, maxsplit=1)[0]
            if node in docstrings and _CLAUSE.match(node.value) and first_sentence[-1:] != "?":
                yield node.lineno, first_sentence
            yield from ((node.lineno, match[0]) for match in _PHRASES.finditer(node.value))
        elif isinstance(node, ast.FunctionDef) and _TEST_NAMES.match(node.name):
            yield node.lineno, node.name
    for line, text in comments(source):
        if _CLAUSE.match(text) and not _CONDITION.match(text):
            yield line, text.partition("\n")[0]
        yield from ((line, match[0]) for match in _PHRASES.finditer(text))


@pytest.mark.parametrize(
    "folder",
    [
        pytest.param(folder, marks=[pytest.mark.xfail] if folder in UNFINISHED else [])
        for folder in folders()
    ],
)
def test_texts_are_free_of_odd_patterns(folder):
    odd = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in sorted(files_of(folder))
        for line, text in odd_texts(path)
        if text not in ALLOWED
    ]
    assert not odd, "\n".join([f"{len(odd)} texts to rewrite:", *odd])
