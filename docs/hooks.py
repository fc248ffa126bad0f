"""What the site has besides its pages: references of packages, pictures, and formulas as MathML."""

import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pygments.formatters import HtmlFormatter


ROOT = Path(__file__).parents[1]
PRIVATE = {"base", "cli"}
MODULES = (
    "base/certificate.py",
    "base/quantities.py",
    "dynamics/systems.py",
    "examples.py",
    "markov/dense.py",
    "robot/ros",
)
# By the theme's names of colours for light and dark pages.
STYLES = {"light": "default", "dark": "github-dark"}
IMAGE = re.compile(r'<img [^>]*src="([^"]+)"[^>]*>')
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([([])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each package, the pictures, and the colours of code."""
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
    css = [
        HtmlFormatter(style=style).get_style_defs(f'[data-bs-theme="{theme}"] .highlight')
        for theme, style in STYLES.items()
    ]
    files.append(File.generated(config, "code.css", content="\n".join(css)))
    return files


def on_page_content(html: str, **_: object) -> str:
    """Write formulas as MathML, which browsers show without a script or a network.

    Pictures are links to themselves: their labels are read in full size only.
    """
    html = IMAGE.sub(r'<a href="\1">\g<0></a>', html)
    return FORMULA.sub(
        lambda found: convert(unescape(found[3]), display="inline" if found[2] == "(" else "block"),
        html,
    )
