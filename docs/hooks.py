"""What the site has besides its pages: references of packages, pictures, and formulas as MathML."""

import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


ROOT = Path(__file__).parents[1]
PRIVATE = {"base", "cli"}
MODULES = ("base/certificate.py", "base/quantities.py")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([([])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each package, and the pictures."""
    top = ROOT / "jaxcell"
    packages = [
        path.parent for path in top.glob("*/__init__.py") if path.parent.name not in PRIVATE
    ]
    for path in (top, *packages, *(top / name for name in MODULES)):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        content = f"---\ntitle: {name}\n---\n::: {name}\n"
        files.append(File.generated(config, f"reference/{name}.md", content=content))
    for path in (ROOT / "data" / "pictures").glob("*.png"):
        files.append(File.generated(config, f"pictures/{path.name}", abs_src_path=str(path)))
    return files


def on_page_content(html: str, **_: object) -> str:
    """Write formulas as MathML, which browsers show without a script or a network."""
    return FORMULA.sub(
        lambda found: convert(found[3], display="inline" if found[2] == "(" else "block"), html
    )
