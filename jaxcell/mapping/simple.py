import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Bool, Int

from ..base.indices import as_array, check_indices
from ..base.shown import Pictured


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SimpleMap(Pictured):
    """A simple cell mapping: every cell has one image (Alam 2018, Eq. 2.2).

    `bumped` is the observation of the robot's bump sensor between a cell and its image. With these
    observations, the map is an I-state graph (Alam 2018, Definition 2.4.1).

    Two steps around a ring of three cells:

        >>> import numpy as np
        >>> from jaxcell import mapping
        >>> ring = mapping.SimpleMap(np.array([1, 2, 0]), np.array([False, False, True]))
        >>> ring.image[ring.image].tolist()
        [2, 0, 1]
    """

    image: Int[Array | np.ndarray, "*batch cells"]
    "The image of each cell."
    bumped: Bool[Array | np.ndarray, "*batch cells"]
    "A mask of the cells where the robot bumps (observation 1)."

    def __post_init__(self) -> None:
        image, bumped = as_array(self.image, "image"), as_array(self.bumped, "bumped")
        if not image.ndim:
            raise ValueError("image: expected the image of each cell, got a number")
        object.__setattr__(self, "image", check_indices(image, image.shape[-1], "image"))
        object.__setattr__(self, "bumped", bumped)
        if self.bumped.shape != self.image.shape or self.bumped.dtype != bool:
            raise ValueError(
                f"bumped: expected a mask of shape {list(self.image.shape)}, got "
                f"{list(self.bumped.shape)} of {self.bumped.dtype}"
            )
