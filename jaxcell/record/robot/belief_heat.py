import dataclasses

import rerun as rr

from ...automata import Belief, BeliefState
from ...space import CellSpace
from ..canvas.belief import arrows, heat, heat_scale
from ..canvas.map import log_classes, on_squares
from ..canvas.marks import points
from ..canvas.palette import KNOWN


# Largest number of cells of a credible set that are shown as arrows.
_FEW = 24


@dataclasses.dataclass(eq=False)
class BeliefHeat:
    """The belief of a robot, logged as a heat map while the robot drives."""

    belief: Belief
    cells: CellSpace
    state: BeliefState = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        if self.belief.hidden.configurations > self.cells.size:
            raise ValueError(
                f"belief: it has {self.belief.hidden.configurations} cells, but the map has "
                f"{self.cells.size}"
            )
        self.state = self.belief.start()

    def observe(self, stream: rr.RecordingStream, observation: int) -> None:
        """Update the belief with an observation, and log the new belief."""
        self.state = self.belief.observe(self.state, observation)
        self.log(stream)

    def log(self, stream: rr.RecordingStream) -> None:
        cells = self.cells
        share = self.belief.hidden.by_position(self.state.weight, cells.positions)
        picture = on_squares(cells, heat(share))
        stream.log("map/grid/heat", rr.SegmentationImage(picture))
        known = self.belief.estimate(self.state).cells
        known = known if known.size <= _FEW else known[:0]
        origins, vectors = arrows(cells, known)
        stream.log("map/credible", rr.Arrows2D(origins=origins, vectors=vectors))

    def log_style(self, stream: rr.RecordingStream) -> None:
        """Log the colours of the heat map and of the arrows, once per recording."""
        log_classes(stream, "map/grid/heat", heat_scale().classes)
        style = rr.Arrows2D.from_fields(colors=KNOWN, radii=points(2.0), draw_order=20)
        stream.log("map/credible", style, static=True)
