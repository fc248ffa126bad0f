"""Add to the pages of the site: references of packages, pictures, and formulas as MathML."""

import re
from html import escape, unescape
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
    *(f"patrol/{part}" for part in ("files", "law", "map", "perimeter", "rounds", "team", "walks")),
    "robot/physics",
    "robot/ros",
)
# Styles of Pygments, by the colour mode of the page.
STYLES = {"light": "default", "dark": "github-dark"}
IMAGE = re.compile(r'<img [^>]*src="([^"]+)"[^>]*>')
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([([])(.*?)\\[)\]]</\1>', re.DOTALL)

# Parts of a page of the reference: the text of its package, code blocks, and code in sentences.
ABOUT = re.compile(
    r'(?<=<div class="doc doc-contents first">).*?(?=<div class="doc doc-children">)', re.DOTALL
)
BLOCK = re.compile(r'<div class="highlight"><pre><span></span><code>([^<]*)</code></pre></div>')
CODE = re.compile(r"(?<!\">)<code>([^<]*)</code>")
GREEK = "alpha beta delta epsilon gamma lambda mu phi pi rho sigma theta"
NAMES = set(re.findall("[a-z]+", GREEK + " exp inf lim log max min prod sqrt sum diag det in"))
UPRIGHT = {"diag": r"\mathrm{diag}", "in": r"\in ", "inf": r"\infty "}
SIGNS = {
    ">=": r"\ge ",
    "<=": r"\le ",
    "->": r"\to ",
    "...": r"\ldots ",
    "*": r"\cdot ",
    ", ": r",\; ",
}
TOKEN = re.compile(
    r"\^\(([^()]*)\)|\^(-?[A-Za-z0-9]+)|([A-Za-z]+)(?:_(?:\{([^{}]*)\}|([A-Za-z0-9]+)))?"
    r"|, |>=|<=|->|\.\.\.|[*{}%&#]"
)
WORD = re.compile(r"[(]?[A-Za-z][a-z'-]+[),.;:]*$")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


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


def is_formula(code: str) -> bool:
    """Test if code in a sentence is mathematics: its names are single letters or in `NAMES`."""
    names = re.findall(r"[A-Za-z]+(?=_|\b)", re.sub(r"_(?:\{[^{}]*\}|[A-Za-z0-9]+)", "", code))
    known = all(len(name) == 1 or name in NAMES for name in names)
    return bool(names) and known and not re.search(r"[\"'`\[\]@:]|--|\w\.\w", code)


def to_latex(formula: str) -> str:
    """Write a formula of a docstring, such as `p_ij >= 0`, in LaTeX."""

    def token(match: re.Match[str]) -> str:
        power, short, name, braced, index = match.groups()
        power = short if power is None else power
        index = index if braced is None else to_latex(braced)
        if power is not None:
            return f"^{{{to_latex(power)}}}"
        if name is None:
            return SIGNS.get(match[0], f"\\{match[0]}")
        shown = UPRIGHT.get(name) or (f"\\{name} " if name in NAMES else name)
        shown = f"\\mathrm{{{name}}}" if shown == name and len(name) > 1 else shown
        return shown if index is None else f"{shown}_{{{index}}}"

    return TOKEN.sub(token, formula)


def mathematics(text: str) -> str:
    """Write the formulas of a line as MathML, and leave its words."""
    parts: list[tuple[bool, list[str]]] = []
    words = text.split()
    for word, after in zip(words, [*words[1:], ""], strict=True):
        bare = word.strip("(),.;:")
        prose = (bool(WORD.match(word)) and bare not in NAMES) or word[0] == "`"
        prose = prose or (bare in ("a", "in") and bool(WORD.match(after)))
        # "stays in E" is a sentence, "x in E" a formula.
        prose = prose or (bare == "in" and bool(parts) and parts[-1][0])
        if parts and parts[-1][0] == prose:
            parts[-1][1].append(word)
        else:
            parts.append((prose, [word]))
    texts = [(prose, " ".join(run)) for prose, run in parts]
    html = (escape(text) if prose else convert(to_latex(text)) for prose, text in texts)
    return re.sub(r"`(.*?)`", r"<code>\1</code>", " ".join(html))


def formulas(match: re.Match[str]) -> str:
    """Write a block of formulas as a table; several spaces separate its columns."""
    if ">>>" in unescape(match[1]):
        return match[0]
    whole = unescape(match[1]).splitlines()
    lines = [re.split(r" {2,}", line.strip()) for line in whole if line.strip()]
    rows = "".join(
        "<tr>" + "".join(f"<td>{mathematics(cell)}</td>" for cell in line) + "</tr>"
        for line in lines
    )
    return f'<table class="formulas">{rows}</table>'


def inline(match: re.Match[str]) -> str:
    """Write code in a sentence as MathML if it is a formula."""
    code = unescape(match[1])
    return convert(to_latex(code)) if is_formula(code) else match[0]


def on_page_content(html: str, **_: object) -> str:
    """Write formulas as MathML, which browsers show without a script or a network.

    Pictures link to their files, because labels are legible in full size only. Lines do not break
    at the hyphens of an option.
    """
    html = ABOUT.sub(lambda match: CODE.sub(inline, BLOCK.sub(formulas, match[0])), html, count=1)
    html = CODE.sub(lambda code: OPTION.sub(r'<span class="option">\g<0></span>', code[0]), html)
    html = IMAGE.sub(r'<a href="\1">\g<0></a>', html)
    return FORMULA.sub(
        lambda match: convert(unescape(match[3]), display="inline" if match[2] == "(" else "block"),
        html,
    )
