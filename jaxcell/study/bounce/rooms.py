import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

from ... import bounce as bouncing
from ...base.limits import Collision
from ..parameters import Angles, Limit, WholeNumber
from ..study import Say, Study, Wanted, every, one_each, radians, silent


if TYPE_CHECKING:
    import numpy as np

    from ...base.quantities import Quantity


# Squares of the rooms whose walls are in memory at once.
_SQUARES = 200_000
_Side: TypeAlias = Annotated[int, Limit(ge=1, le=10_000)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rooms(Study):
    """Find the periodic groups and the localization filter of a bouncing robot in a random room.

    The seed and the number of a room determine the room. The robot knows its heading.
    """

    name: ClassVar[str] = "room"
    task: ClassVar[str] = "rooms"
    varied: ClassVar[tuple[str, ...]] = ("room", "bounce")

    room: WholeNumber
    """Number of the room, from 0."""
    bounce: Angles
    """Bouncing angles in degrees, counter-clockwise."""
    environment: Literal["random", "E1", "E2", "E3", "E4"] = "random"
    """Kind of room: with rectangles at random places (random), or an environment of Figure 2.7 of
    Alam 2018 (E1 to E4)."""
    columns: _Side = 50
    """Number of columns of squares in a random room."""
    rows: _Side = 45
    """Number of rows of squares in a random room."""
    obstacles: Annotated[int, Limit(ge=0, le=1000)] = 6
    """Number of rectangles in a random room."""
    directions: Annotated[int, Limit(ge=1, le=3600)] = 360
    """Number of directions in which the robot can drive."""
    collision: Collision = "swept"
    """Part of a step that must be free: all (swept), or only its end, as in Alam 2018
    (endpoint)."""
    seed: WholeNumber = 0
    """Seed of the rooms."""

    def free(self, room: int | None = None) -> Any:
        """Return a mask of the free squares of the room, or of another room."""
        from ...space.maps.random_rooms import place, random_room

        number = self.room if room is None else room
        if self.environment == "random":
            return random_room(self.seed, number, self.columns, self.rows, self.obstacles)
        return place(self.seed, self.environment, number).free

    def run(self, say: Say = silent) -> "bouncing.RoomGroups":
        return bouncing.RoomGroups.of_room(
            self.free(), radians(self.bounce), self.directions, motion=self._motion
        )

    @property
    def _motion(self) -> "bouncing.Motion":
        return bouncing.Motion(collision=self.collision)

    def numbers(
        self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = every
    ) -> "dict[str, tuple[Quantity, np.ndarray]]":
        import numpy as np

        from ...base.quantities import quantities

        given = one_each("room", columns, (self.room,)), one_each("bounce", columns, self.bounce)
        room, bounce = np.broadcast_arrays(*given)
        each, of_room = np.unique(room, return_inverse=True)
        # Rooms with other angles are computed one after the other.
        product = each.size * np.unique(bounce).size <= 2 * room.size
        together = max(1, _SQUARES // self.free().size) if product else 1
        by_room = np.argsort(of_room, kind="stable")
        first = range(0, each.size, together)
        parts = np.split(by_room, np.searchsorted(of_room[by_room], first)[1:])
        found: dict[str, np.ndarray] = {}
        for start, rows in zip(first, parts, strict=True):
            angle, at_angle = np.unique(bounce[rows], return_inverse=True)
            rooms = [self.free(one) for one in each[start : start + together].tolist()]
            numbers = bouncing.RoomGroups.numbers(
                np.stack(rooms),
                np.radians(angle),
                self.directions,
                motion=self._motion,
                wanted=wanted,
            )
            for name, values in numbers.items():
                column = found.setdefault(name, np.empty(room.size, values.dtype))
                column[rows] = values[of_room[rows] - start, at_angle]
        described = quantities(bouncing.RoomGroups)
        return {name: (described[name], column) for name, column in found.items()}

    def headline(self, spec: dict[str, Any]) -> str:
        return f"Room {self.room} of seed {self.seed}"
