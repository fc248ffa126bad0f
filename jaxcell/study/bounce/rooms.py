import dataclasses
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from ... import bounce as bouncing
from ...base.limits import Collision
from ..parameters import Degrees, Limit, WholeNumber
from ..study import Say, Study, radians, silent


_Side: TypeAlias = Annotated[int, Limit(ge=1, le=10_000)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rooms(Study):
    """Find the periodic groups and the localization filter of a bouncing robot in a random room.

    The seed and the number of a room determine the room. The robot knows its heading.
    """

    name: ClassVar[str] = "room"
    task: ClassVar[str] = "rooms"
    batch: ClassVar[str | None] = "bounce"

    room: WholeNumber
    """Number of the room, from 0."""
    bounce: tuple[Degrees, ...]
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

    def free(self) -> Any:
        """Return a mask of the free squares of the room."""
        from ...space.maps.random_rooms import place, random_room

        if self.environment == "random":
            return random_room(self.seed, self.room, self.columns, self.rows, self.obstacles)
        return place(self.seed, self.environment, self.room).free

    def run(self, say: Say = silent) -> "bouncing.RoomGroups":
        motion = bouncing.Motion(collision=self.collision)
        return bouncing.RoomGroups.of_room(
            self.free(), radians(self.bounce), self.directions, motion=motion
        )

    def headline(self, spec: dict[str, Any]) -> str:
        return f"Room {self.room} of seed {self.seed}"
