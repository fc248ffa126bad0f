import dataclasses
import importlib.metadata
import webbrowser
from pathlib import Path
from typing import ClassVar

from ..base.display import has_display
from .terminal import say


_BUILT = Path(__file__).parents[2] / "docs" / "site" / "index.html"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Docs:
    """Open the documentation in a browser: what `make docs` built in a checkout, else that of the
    installed version."""

    example: ClassVar[str] = ""

    def run(self) -> int:
        address = _address()
        say(address)
        if has_display():
            webbrowser.open(address)
        return 0


def _address() -> str:
    """Where the documentation is.

    **Raises:** `FileNotFoundError` if it is nowhere.
    """
    if _BUILT.exists():
        return _BUILT.as_uri()
    named = importlib.metadata.metadata("jaxcell").get_all("Project-URL") or []
    urls = dict(one.split(", ", 1) for one in named)
    if "Documentation" not in urls:
        raise FileNotFoundError("there is none yet; `make docs` in a checkout of jaxcell builds it")
    return urls["Documentation"]
