import dataclasses
import webbrowser
from pathlib import Path
from typing import ClassVar

from ..base.process import has_display
from .terminal import say


PACKAGE = Path(__file__).parents[1]
BUILT = (PACKAGE.parent / "docs" / "site" / "index.html", PACKAGE / "data" / "pages" / "index.html")
"""The first page of the site that `make docs` builds, and of the pages of a package."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Docs:
    """Open the documentation in a browser: the site of `make docs`, or the pages of the package."""

    example: ClassVar[str] = ""

    def run(self) -> int:
        page = next((page for page in BUILT if page.exists()), None)
        if page is None:
            raise FileNotFoundError(
                "there is no documentation; in a checkout `make docs` builds it"
            )
        say(page.as_uri())
        if has_display():
            webbrowser.open(page.as_uri())
        return 0
