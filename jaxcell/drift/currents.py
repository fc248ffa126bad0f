"""The currents of the sea, which `jaxcell.currents` reads."""

from ..currents.ocean import open_currents as open_currents
