"""Parts of a package that are made: pages of the documentation, and links that work on an index."""

import json
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface
from markdown_it import MarkdownIt


# A link or a picture whose address is a file of this repository.
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!\w+:|#)([^)#]+)(#[^)]*)?\)")
REFERENCE = re.compile(r"\[(`[^`]+`)\]\[\]")
INCLUDED = re.compile(r'^--8<-- "([^":]+)(?::(\w+))?"$', re.MULTILINE)
FORMULA = re.compile(r"\\([(\[])(.*?)\\[)\]]", re.DOTALL)
HEADING = re.compile(r"<h2>(.*?)</h2>")
PAGE = """<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title} - jaxcell</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 1rem/1.5 sans-serif; max-width: 55rem; margin: 1rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }}
pre, table {{ display: block; overflow-x: auto; line-height: 1.2; }}
td, th {{ padding: 0.2rem 0.6rem; text-align: left; }}
</style>
<p><a href="{start}">jaxcell</a></p>
{body}
</html>
"""


class Metadata(MetadataHookInterface):
    """Add the addresses of the project, and README with absolute links."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in the dynamic fields. Without a repository README has no links to files."""
        repository = self.config["repository"]
        paths = {
            "Source": "",
            "Documentation": "/blob/HEAD/docs/pages/index.md",
            "Changelog": "/blob/HEAD/docs/pages/changelog.md",
            "Issues": "/issues",
        }
        metadata["urls"] = {name: repository + path for name, path in paths.items() if repository}

        def absolute(picture: str, path: str) -> str:
            kind = "raw" if picture else "blob"
            return f"{repository}/{kind}/HEAD/{path}" if repository else ""

        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": relink(text, absolute)}


class Pages(BuildHookInterface[Any]):
    """Add the pages of the documentation, which `jaxcell docs` opens."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the pages of a wheel to a folder, and add the folder to the wheel."""
        if version != "editable":
            self.folder = tempfile.TemporaryDirectory()
            write_pages(Path(self.root), Path(self.folder.name))
            build_data["force_include"][self.folder.name] = "jaxcell/data/pages"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the folder."""
        if version != "editable":
            self.folder.cleanup()


def relink(text: str, address: Callable[[str, str], str]) -> str:
    """Replace the addresses of links to files. Those without a new address become their text."""

    def link(match: re.Match[str]) -> str:
        picture, label, path, part = match.groups()
        new = address(picture, path)
        return f"{picture}[{label}]({new}{part or ''})" if new else "" if picture else label

    return LINK.sub(link, text)


def write_pages(root: Path, folder: Path) -> None:
    """Write the pages, the notebooks and the pictures of the documentation."""
    (folder / "pictures").mkdir()
    for picture in (root / "data" / "pictures").glob("*.png"):
        shutil.copy(picture, folder / "pictures")
    pages = root / "docs" / "pages"
    texts = {
        source.relative_to(pages).with_suffix(".html"): _markdown(root, source)
        for source in sorted([*pages.rglob("*.md"), *pages.rglob("*.ipynb")])
    }
    titles = {path: re.search("^# (.*)$", text, re.MULTILINE)[1] for path, text in texts.items()}
    every = "\n".join(f"- [{title}]({path.as_posix()})" for path, title in titles.items())
    texts[Path("index.html")] += f"\n\n## All pages\n\n{every}\n"
    for path, text in texts.items():
        body = HEADING.sub(_anchor, MarkdownIt().enable("table").render(text))
        start = "../" * (len(path.parts) - 1) + "index.html"
        page = folder / path
        page.parent.mkdir(exist_ok=True)
        page.write_text(PAGE.format(title=titles[path], start=start, body=body), encoding="utf-8")


def _markdown(root: Path, source: Path) -> str:
    """Read a page or a notebook as plain Markdown, with links to the other pages."""
    text = source.read_text(encoding="utf-8")
    if source.suffix == ".ipynb":
        text = "\n\n".join(map(_cell, json.loads(text)["cells"]))
    text = INCLUDED.sub(lambda match: _part(root / match[1], match[2]), text)
    text = REFERENCE.sub(r"\1", FORMULA.sub(r"`\2`", text))
    return relink(text, lambda _, path: re.sub(r"\.md$", ".html", path))


def _cell(cell: dict[str, Any]) -> str:
    """Write a cell of a notebook in Markdown."""
    source = "".join(cell["source"])
    return source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```"


def _part(path: Path, name: str | None) -> str:
    """Read a file, or the part of it between the marks of a name."""
    text = path.read_text(encoding="utf-8")
    if name is None:
        return text
    start, end = (rf"<!-- --8<-- \[{mark}:{name}\] -->" for mark in ("start", "end"))
    return re.split(end, re.split(start, text)[1])[0]


def _anchor(match: re.Match[str]) -> str:
    """Name a heading by its words, as links do."""
    words = re.sub(r"<[^>]*>|[^\w\s-]", "", match[1]).lower().split()
    return f'<h2 id="{"-".join(words)}">{match[1]}</h2>'
