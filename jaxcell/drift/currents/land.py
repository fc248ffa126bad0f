"""The bundled coastline, for scripts that import it from here."""

from ...currents.land import read_land as read_land
