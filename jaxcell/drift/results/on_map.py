from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.quantities import Result, derived
from ..water import Water


class OnMap(Result):
    """A result on the grid of a map, with the coordinates of its squares."""

    @property
    def waters(self) -> tuple[Water, ...]:
        """The water cells of each layer."""
        raise NotImplementedError

    @derived("y x", "longitude", "degrees_east", kind="coordinate", standard_name="longitude")
    def lon(self) -> Float[np.ndarray, "rows columns"]:
        return self.waters[0].lon

    @derived("y x", "latitude", "degrees_north", kind="coordinate", standard_name="latitude")
    def lat(self) -> Float[np.ndarray, "rows columns"]:
        return self.waters[0].lat


class InOneLayer(OnMap):
    """A result of drifters in one layer, with the fields `water`, `hours` and `notices`."""

    water: Any
    hours: Any
    notices: tuple[str, ...]

    @property
    def waters(self) -> tuple[Water, ...]:
        """The cells of the only layer."""
        return (self.water,)

    @property
    def step(self) -> float:
        """The seconds until the first time of the result."""
        return float(3600 * self.hours[0])

    @property
    def remarks(self) -> tuple[str, ...]:
        return self.notices
