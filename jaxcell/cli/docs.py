import dataclasses
import importlib.metadata
import webbrowser
from pathlib import Path
from typing import ClassVar

from ..base.process import has_display
from .terminal import say


BUILT = Path(__file__).parents[2] / "docs" / "site" / "index.html"
"""The first page of the documentation that `make docs` builds in a checkout."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Docs:
    """Open the documentation in a browser: the pages that `make docs` built, or the website."""

    example: ClassVar[str] = ""

    def run(self) -> int:
        address = _address()
        say(address)
        if has_display():
            webbrowser.open(address)
        return 0


def _address() -> str:
    if BUILT.exists():
        return BUILT.as_uri()
    named = importlib.metadata.metadata("jaxcell").get_all("Project-URL") or []
    urls = dict(url.split(", ", 1) for url in named)
    if "Documentation" not in urls:
        raise FileNotFoundError("there is no documentation; in a checkout `make docs` builds it")
    return urls["Documentation"]
