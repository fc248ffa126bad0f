"""The files of ocean models and radars, as currents on the cells of a grid.

`open_currents` reads them into an `xarray.Dataset` of one normal form, whatever their model, axes,
units and calendar. Its dimensions are time, layer, y and x, the surface first and, on a grid of
latitude and longitude, the South and West first:

- `u`, `v`: velocity towards the East and North in m/s, NaN where there is no water;
- `water`: the mask of the squares of each layer that are water;
- `land`: the mask of land or the sea bed; squares in neither mask are sea without data;
- `dx`, `dy`: the sides of each cell along the x and y axes of the grid, in metres;
- `angle`: the angle from East to the x axis, counter-clockwise, in radians;
- coordinates `time` (UTC), `depth` of each layer in metres, `lon` and `lat` of the centres;
- attributes `source`; `east_from` and `north_from`, the variables and the reason for their choice;
    `notes`, one line per note on how the file was read; `mean_of`, the number of records in the
    mean, or 1; and `coastline`, the file of land that the caller gave, or "".

A cell is water if it has a velocity at 80 % of the chosen records or more, and is water in the mask
of the file, if there is one. Gaps are interpolated in time; values with a bad quality flag count as
gaps. Masks are recognised by the names that ocean models use, by flags or options such as
`option_0`, or by a standard name. Other squares are land, the sea bed, or *sea without data*, an
open edge of the map. A square below a square with a velocity is the sea bed. For other squares the
mask decides; without a mask, the depth of the sea bed; without this depth, a coastline: a square
that contains land is land.

No part of this package imports JAX.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
