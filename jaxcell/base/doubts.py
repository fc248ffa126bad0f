import sys
import warnings


# Packages whose functions are between the program and a warning.
_BETWEEN = ("jaxcell", "functools", "jaxtyping", "beartype")


class Doubt(UserWarning):
    """A warning that values in a file may not mean what they say, and that the answer depends on
    them.

    Readers of files issue it in one line with the file, the number of values and what was done.
    Every command prints it on standard error above the answer.
    """


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Issue a warning about the line of the program that called the library."""
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in _BETWEEN:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)
