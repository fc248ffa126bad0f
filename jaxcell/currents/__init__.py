"""The files of ocean models and radars, as currents on the cells of a grid.

`open_currents` reads them into an `xarray.Dataset` of one normal form, whatever their model, axes,
units and calendar: velocities towards the East and North in m/s at the centres of the cells, masks
of water and land, the sides of the cells in metres, and dates.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
