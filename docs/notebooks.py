"""Run the notebooks of the tutorials when the site is built, and add their pages."""

import base64
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbclient import NotebookClient


# HTML outputs of cells in order, by page. Marks replace them in Markdown, which would change them.
_SHOWN: dict[str, list[str]] = {}
_PLACE = re.compile(r"<p>@output (\d+)@</p>")
_FENCE = "~~~"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Run the notebooks, and add a page for each. An error in a cell fails the build."""
    sources = [file for file in files if file.src_uri.endswith(".ipynb")]
    with ThreadPoolExecutor(2) as pool:
        notebooks = list(pool.map(_run, (str(file.abs_src_path) for file in sources)))
    for file, notebook in zip(sources, notebooks, strict=True):
        stem = file.src_uri.removesuffix(".ipynb")
        pictures: list[bytes] = []
        shown = _SHOWN[f"{stem}.md"] = []
        parts = [_cell(cell, Path(stem).name, pictures, shown) for cell in notebook.cells]
        parts.insert(1, f"[Download this notebook]({Path(stem).name}.ipynb)")
        page = File.generated(config, f"{stem}.md", content="\n\n".join(parts))
        files.append(page)
        for number, picture in enumerate(pictures):
            name = f"{stem}_{number}.png"
            files.append(File.generated(config, name, content=picture))
    return files


def on_page_content(html: str, page: Page, **_: object) -> str:
    """Replace the marks of a page by the HTML outputs of its cells."""
    shown = _SHOWN.get(page.file.src_uri, [])
    return _PLACE.sub(lambda found: shown[int(found[1])], html)


def _run(path: str) -> Any:
    """Run a notebook as a user would."""
    notebook = nbformat.read(path, as_version=4)
    quiet = ["--log-level=40"]
    NotebookClient(notebook, timeout=300, kernel_name="python3", extra_arguments=quiet).execute()
    return notebook


def _cell(cell: Any, stem: str, pictures: list[bytes], shown: list[str]) -> str:
    """Write a cell and its output in Markdown."""
    if cell.cell_type == "markdown":
        return str(cell.source)
    parts = [f"{_FENCE} python\n{cell.source}\n{_FENCE}"]
    for output in cell.outputs:
        data = output.get("data", {})
        if "text/html" in data:
            parts.append(f"@output {len(shown)}@")
            shown.append(data["text/html"])
        elif "image/png" in data:
            parts.append(f"![output of the cell]({stem}_{len(pictures)}.png)")
            pictures.append(base64.b64decode(data["image/png"]))
        elif output.get("name") != "stderr":
            text = output.get("text", "") or data.get("text/plain", "")
            parts.append(f"{_FENCE} text\n{text.rstrip()}\n{_FENCE}")
    return "\n\n".join(parts)
