"""`python -m jaxcell` is the command `jaxcell`."""

import sys

from .cli import main


if __name__ == "__main__":
    sys.exit(main())
