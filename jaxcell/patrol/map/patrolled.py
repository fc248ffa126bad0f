import dataclasses
import itertools
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.formatting import counted, percent
from ...base.quantities import Result, derived, from_part, quantity
from ...optimize import Graph
from ...space import CellSpace
from ..team.rounds import Round
from .attacked_cell import Vulnerability
from .capture import Capture
from .capture_search import CaptureSearch, Frontier, entropy_rate
from .policies import Policy, of_policies
from .reassignment import Reassignment
from .regions import Regions


# A cell counts as never visited if all robots together spend less than this share of time there.
_NEVER = 1e-6
_BEGUN = {
    "stationary": "have been walking for long",
    "uniform": "begin in any cell, out of its view",
    "worst": "are where it has the best chance",
}


@dataclasses.dataclass(frozen=True, eq=False)
class PatrolledMap(Result):
    """A patrol of a map by robots, and the probability that the robots capture an adversary."""

    title: ClassVar[str] = "Patrol of a map with limited visibility"
    picture: ClassVar[str] = "captures_probability"
    tables: ClassVar[Mapping[str, str]] = {
        "robot": "policies",
        "share": "shares",
        "size": "team_sizes",
    }

    leading: ClassVar[tuple[str, ...]] = (
        "least_capture",
        "least_captured",
        "mean_capture",
        "steps_of_attack",
        "begun",
        "watched_capture",
        "watched_place",
    )

    cells: CellSpace
    reach: Annotated[float, quantity("", "range of sight of a robot", "m")]
    graph: Graph
    "The cells and the edges between them, [`jaxcell.patrol.cell_graph`][]."
    visible: Annotated[
        Bool[np.ndarray, "cells cells"],
        quantity("position other", "whether a robot at position sees other", kind="flag"),
    ]
    "See [`jaxcell.space.visible_cells`][]."
    policies: tuple[Policy, ...]
    attack: Vulnerability
    captures: Capture
    regions: Regions | None = None
    "The region of each robot around a base station, or `None` if there is no base station."
    reassignment: Reassignment | None = None
    "The new regions after a robot has stopped reporting, or `None`."
    loss: Capture | None = None
    "The probability of capture if a robot fails and the others keep their regions, or `None`."
    recovery: Capture | None = None
    "The probability of capture if a robot fails and the others get new regions, or `None`."
    sight: Annotated[
        Literal["centre", "cell", "source"], quantity("", "part of a cell that a robot must see")
    ] = "cell"
    search: CaptureSearch | None = None
    "The search that found the policies, if they were chosen to maximise capture; otherwise `None`."
    frontier: Frontier | None = None
    round: Round | None = None
    "The closed tour with evenly spaced robots on a shared clock, to compare, or `None`."
    left_out: tuple[str, ...] = ()
    "Sentences about the secondary quantities that could not be computed and are `None`."
    share: Annotated[
        Float[np.ndarray, "shares"] | None,
        quantity("share", "share of steps on the tours", "1", kind="coordinate"),
    ] = None
    "The lower bounds on the share of steps along the tours that were compared, or `None`."
    share_capture: Annotated[
        Float[np.ndarray, "shares"] | None,
        quantity("share", "capture at the weakest cell, first attack time", "1", kind="share"),
    ] = None
    smallest_covers: Float[np.ndarray, "robots"] | None = None
    "The least number of positions from which all cells of each robot are seen; NaN if unknown."
    chosen_share: Annotated[
        float | None, quantity("", "share of steps on the tours", "1", kind="share")
    ] = None
    wanted: Annotated[
        float | None, quantity("", "least probability of capture that is wanted", "1", kind="share")
    ] = None
    size_capture: Annotated[
        Float[np.ndarray, "sizes"] | None,
        quantity("size", "capture at the weakest cell, first attack time", "1", kind="share"),
    ] = None
    "The probability of capture by a team of one robot, of two robots, and so on."
    seed: int = 0
    "Seed of the patrol that a recording shows."

    def __post_init__(self) -> None:
        positions = self.cells.positions
        sizes = {
            "graph": self.graph.vertices,
            "visible": len(self.visible),
            "attack": self.attack.view.size,
            "captures": self.captures.probability.shape[1],
            **{f"policies[{i}]": policy.chain.cells for i, policy in enumerate(self.policies)},
        }
        if self.regions is not None:
            sizes["regions"] = self.regions.region.size
        for name, size in sizes.items():
            if size != positions:
                raise ValueError(f"{name}: expected {positions} cells, got {size}")
        if self.cells.workspace is None:
            raise ValueError("cells: expected the cells of a map, got a grid")
        if not np.array_equal(self.captures.attack.times, self.attack.attack_time):
            raise ValueError(
                f"captures: expected the attack times {self.attack.attack_time.tolist()}, got "
                f"{self.captures.attack.times.tolist()}"
            )
        if self.reassignment is not None and self.regions is None:
            raise ValueError("reassignment: expected regions with it, got none")

    @property
    def answered(self) -> bool:
        """`True` if the robots reach the wanted probability of capture."""
        if self.wanted is None or self.size_capture is None:
            return True
        return float(self.size_capture[-1]) >= self.wanted

    @property
    def answer(self) -> tuple[str, ...]:
        stay, cell = self.steps_of_attack, self.least_captured
        x, y, _ = self.cells.centre(cell)
        stays = f"An intruder who stays {counted(stay, 'step')} is caught"
        walks = (
            f"{stays} with a probability of at least {percent(self.least_capture)}; it is least at "
            f"{x:g} m, {y:g} m."
        )
        sentences = []
        if self.wanted is not None:
            suffice = "suffice" if self.answered else "do not suffice"
            robots, wanted = counted(self.robots, "robot"), percent(self.wanted)
            sentences.append(
                f"{robots} {suffice} to catch an intruder with a probability of {wanted}."
            )
        caught = self._caught_by_round
        if caught is None or self.round is None or caught <= self.least_capture:
            return (*sentences, walks)
        if self.round.watched_capture:
            first = f"No intruder who stays {counted(stay, 'step')} escapes {self.round.followers}."
        else:
            first = (
                f"{stays} by {self.round.followers}, with a probability of at least "
                f"{percent(caught)}."
            )
        return (*sentences, first, f"By random walks: {walks[0].lower()}{walks[1:]}")

    @derived("", "probability that an intruder is caught, at least", "1", kind="share")
    def least_capture(self) -> float:
        return float(self.captures.least[0])

    @derived("", "cell where it is least", kind="place")
    def least_captured(self) -> int:
        return int(self.captures.weakest[0])

    @derived("", "its mean over the cells", "1", kind="share")
    def mean_capture(self) -> float:
        return float(self.captures.mean[0])

    @derived("", "steps that the intruder stays", "steps", kind="count")
    def steps_of_attack(self) -> int:
        return int(self.captures.attack_time[0])

    @derived("", "robots at the start of the attack")
    def begun(self) -> str:
        return _BEGUN[self.captures.attack.start]

    @derived("", "least probability of capture, if the intruder sees the robots", "1", kind="share")
    def watched_capture(self) -> float:
        return float(self.captures.least_watched[0])

    @derived("", "cell where that is least", kind="place")
    def watched_place(self) -> int:
        return int(self.captures.weakest_watched[0])

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = []
        if self.search is not None:
            starts = self.search.tried.size
            tried = "1 start" if starts == 1 else f"{starts} starts"
            remarks.append(
                f"the patrol is a local optimum of a search from {tried}; another may capture more"
            )
            if self.search.tours is not None:
                remarks.append(
                    "closed tours through the covers, whose phases are independent, capture with a "
                    f"probability of {self.search.tours:.3f} at least"
                )
        if (remark := self._compared_with_round) is not None:
            remarks.append(remark)
        search = self.search
        if search is not None and not search.certificate.converged:
            remarks.append(
                f"the last quarter of the steps still added {search.late_gain:.1%} to its least "
                "probability of capture"
            )
        if not self.answered and self.size_capture is not None:
            remarks.append(
                f"{self.robots} robots capture with a probability of {self.size_capture[-1]:.3f} "
                f"at least; {self.wanted:g} is not reached"
            )
        if self.share_capture is not None:
            least, chosen = self.share_capture, self.chosen_share
            plain = float(least[self.share == 0].max(initial=0))
            taken = float(least[self.share == chosen].max(initial=0))
            if chosen is not None and taken < plain:
                remarks.append(
                    f"an emphasis of {chosen:g} lowers the least probability of capture from "
                    f"{plain:.3f} to {taken:.3f}"
                )
        if np.isnan([policy.commute_time for policy in self.policies]).any():
            remarks.append("commute times are left out: the equations for them are singular")
        return (*remarks, *self.left_out)

    @property
    def _compared_with_round(self) -> str | None:
        """A sentence that compares the least probability of capture with that of a round."""
        caught = self._caught_by_round
        if caught is None or self.round is None:
            return None
        beaten = caught > self.least_capture
        return f"{self.round.followers}, capture with a probability of {caught:.3f} at least" + (
            ", more than this patrol" if beaten else ""
        )

    @property
    def _caught_by_round(self) -> float | None:
        """The least probability of capture by the round, for the adversary of the attack."""
        if self.round is None:
            return None
        watched = self.captures.attack.start == "worst"
        return self.round.watched_capture if watched else self.round.least_capture

    @property
    def xy(self) -> Float[np.ndarray, "cells 2"]:
        """The centre of each cell, in metres."""
        x, y, _ = self.cells.centre(np.arange(self.cells.positions))
        return np.stack([x, y], axis=1)

    @derived("", "robots", kind="count")
    def robots(self) -> int:
        return len(self.policies)

    @derived("size", "robots", kind="coordinate")
    def size(self) -> Int[np.ndarray, "sizes"] | None:
        return None if self.size_capture is None else np.arange(1, self.size_capture.size + 1)

    @derived("", "edges between cells", kind="count")
    def edges(self) -> int:
        return len(self.graph.edges)

    @derived("", "cells seen from a cell, on average")
    def mean_cells_seen(self) -> float:
        return float(self.visible.sum(axis=1).mean())

    @derived("", "fewest cells seen from a cell", kind="count")
    def least_cells_seen(self) -> int:
        return int(self.visible.sum(axis=1).min())

    @derived("", "most cells seen from a cell", kind="count")
    def most_cells_seen(self) -> int:
        return int(self.visible.sum(axis=1).max())

    @derived("", "cells in effect never visited (less than once in a million steps)", kind="count")
    def never_visited(self) -> int:
        shares = np.stack([policy.share_of_time(self.graph) for policy in self.policies])
        return int(np.count_nonzero(shares.sum(axis=0) < _NEVER))

    @derived("unseen", "cells that no robot can see", kind="index", listed=True)
    def seen_by_nobody(self) -> Int[np.ndarray, "unseen"]:
        return np.flatnonzero(~self.visible.any(axis=0))

    end = from_part("graph.edges", "edge side", "cells at the ends of the edge", kind="index")

    @derived("robot", "robot", kind="coordinate")
    def robot(self) -> Int[np.ndarray, "robots"]:
        return np.arange(self.robots)

    cells_patrolled = of_policies("cells.size", "robot", "cells that it patrols", kind="count")

    @derived("robot stop", "cells of the cover in their order", kind="index", listed=True)
    def cover(self) -> Int[np.ndarray, "robots stops"]:
        return _padded([policy.cover for policy in self.policies])

    cover_size = of_policies("cover.size", "robot", "cells of its cover", kind="count")
    minimum_cover = from_part("smallest_covers", "robot", "cells of the smallest cover")

    @derived("robot", "cells of its cover to those of the smallest")
    def cover_ratio(self) -> Float[np.ndarray, "robots"] | None:
        return None if self.smallest_covers is None else self.cover_size / self.smallest_covers

    uncovered = of_policies("uncovered.size", "robot", "cells that it cannot see", kind="count")

    @derived("robot", "steps of its tour, 0 for none", kind="count")
    def tour_steps(self) -> Int[np.ndarray, "robots"]:
        tours = (policy.tour for policy in self.policies)
        return np.array([0 if tour is None else tour.size for tour in tours])

    commute_time = of_policies(
        "commute_time", "robot", "mean commute time over pairs of cells", "steps", kind="time"
    )

    @derived("robot", "entropy of its step in the long run", "nats")
    def entropy_rate(self) -> Float[np.ndarray, "robots"]:
        return np.array([entropy_rate(self.graph, policy) for policy in self.policies])

    @derived("robot", "duality gap of its weights, relative", kind="residual")
    def duality_gap(self) -> Float[np.ndarray, "robots"] | None:
        gaps = [each.certificate.residual for each in self.policies if each.certificate is not None]
        return np.array(gaps) if len(gaps) == self.robots else None

    @derived("robot", "cell where it reports", kind="place")
    def contact(self) -> Int[np.ndarray, "robots"] | None:
        contacts = [policy.contact for policy in self.policies]
        return None if None in contacts else np.array(contacts)

    weight = of_policies("weights", "robot edge", "share of steps on the edge", "1", kind="share")

    @derived("robot branch position", "cell that a step may lead to", kind="index")
    def image(self) -> Int[np.ndarray, "robots branches cells"]:
        return _padded([np.asarray(policy.chain.image) for policy in self.policies])

    @derived("robot branch position", "its probability", "1", kind="distribution", over="branch")
    def probability(self) -> Float[np.ndarray, "robots branches cells"]:
        return _padded([np.asarray(policy.chain.probability) for policy in self.policies], 0.0)


def _padded(rows: list[np.ndarray], fill: float | int = -1) -> np.ndarray:
    """Stack arrays of different lengths, with `fill` after their ends."""
    filled = np.full(rows[0].shape[1:], fill, rows[0].dtype)
    return np.array(list(itertools.zip_longest(*rows, fillvalue=filled))).swapaxes(0, 1)
