"""Replace characters that are missing in the encoding of an output by ASCII characters."""

import codecs
import io
import sys
import unicodedata


_HANDLER = "jaxcell-ascii"
_ASCII = str.maketrans({"°": " deg", "▀": "'", "▄": ".", "█": "#"})


def allow_any_encoding() -> None:
    """Let standard output and standard error replace the characters that they cannot encode."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors != _HANDLER:
            stream.reconfigure(errors=_HANDLER)


def encodable(text: str, encoding: str) -> str:
    """Replace characters that an encoding does not have. The new text may be longer.

    >>> from jaxcell.cli.encoding import encodable
    >>> encodable("45° in 2 m²", "ascii")
    '45 deg in 2 m2'
    """
    return text.encode(encoding, _HANDLER).decode(encoding)


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(_ASCII)
    letters = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(c if c.isascii() else "?" for c in letters), error.end


codecs.register_error(_HANDLER, _in_ascii)
