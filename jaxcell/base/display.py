import os
import sys


def has_display() -> bool:
    """Whether a window can be shown from here."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
