import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.formatting import percent
from ...base.quantities import Result, derived, from_part, quantity
from .bounding import Bound
from .evaluation import Evaluation, evaluate
from .game import Game
from .route import Route


# Relative difference below which times are equal.
_SAME = 1e-6
# Largest number of stops of a guard in a sentence, and of guards.
_STOPS, _GUARDS = 24, 6


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Guarded(Result):
    """Robots that guard targets by rounds with a shared clock. Targets are in order of risk."""

    title: ClassVar[str] = "Rounds of guards with a shared clock"
    tables: ClassVar[Mapping[str, str]] = {"target": "targets", "robot": "guards"}
    leading: ClassVar[tuple[str, ...]] = ("risk", "longest_between", "unit")
    picture: ClassVar[str] = "exposure"

    game: Game
    routes: Sequence[Route]
    evaluation: Evaluation
    bound: Bound | None = None
    walks_capture: Annotated[
        float | None,
        quantity(
            "",
            "least capture by independent random walks, for the same adversary",
            "1",
            kind="share",
        ),
    ] = None
    "The least probability of capture over targets by the best independent walks that are found."
    left_out: tuple[str, ...] = ()
    "Sentences about quantities that could not be computed."

    @classmethod
    def of(cls, game: Game, routes: Sequence[Route], **others: Any) -> "Guarded":
        """Evaluate the routes of robots; the keywords are fields of the result."""
        return cls(game=game, routes=routes, evaluation=evaluate(game, routes), **others)

    @property
    def order(self) -> "np.ndarray":
        """The index in the game of each target, by risk, the largest first."""
        late = self.evaluation.longest / self.game.attack
        return np.lexsort((-late, -np.round(self.evaluation.risk(self.game), 9)))

    @derived("target", "target", kind="coordinate")
    def target(self) -> list[str]:
        return [self.game.names_of_targets[target] for target in self.order.tolist()]

    @derived("target", "x", "m", kind="coordinate")
    def x(self) -> Float[np.ndarray, "targets"] | None:
        return None if self.game.xy is None else self.game.xy[self.game.targets[self.order], 0]

    @derived("target", "y", "m", kind="coordinate")
    def y(self) -> Float[np.ndarray, "targets"] | None:
        return None if self.game.xy is None else self.game.xy[self.game.targets[self.order], 1]

    @derived("target", "duration of an attack", kind="time")
    def attack_time(self) -> Float[np.ndarray, "targets"]:
        return self.game.attack[self.order]

    @derived("target", "value", kind="number")
    def value(self) -> Float[np.ndarray, "targets"] | None:
        return self.game.value[self.order] if np.ptp(self.game.value) else None

    @derived("target", "longest time between visits", kind="time")
    def between(self) -> Float[np.ndarray, "targets"]:
        return self.evaluation.longest[self.order]

    @derived("target", "share of moments at which an attack succeeds", "1", kind="share")
    def exposure(self) -> Float[np.ndarray, "targets"]:
        return self.evaluation.exposure[self.order]

    @derived("target", "guards that visit it", kind="text", listed=True)
    def visitors(self) -> list[str]:
        rows = []
        for vertex in self.game.targets[self.order].tolist():
            there = [r for r, one in enumerate(self.routes, 1) if (one.vertex == vertex).any()]
            rows.append(", ".join(map(str, there)) or "none")
        return rows

    @derived("robot", "guard", kind="coordinate")
    def robot(self) -> list[int]:
        return list(range(1, len(self.routes) + 1))

    @derived("robot", "duration of a round", kind="time")
    def round(self) -> Float[np.ndarray, "robots"]:
        return np.array([route.period for route in self.routes])

    @derived("robot stop", "vertices in order", kind="text", listed=True)
    def stops(self) -> "np.ndarray":
        rows = [[self.game.names[v] for v in route.vertex.tolist()] for route in self.routes]
        most = max(map(len, rows))
        return np.array([row + [""] * (most - len(row)) for row in rows])

    @derived(
        "",
        "least probability of capture, for an adversary who comes at a random time",
        "1",
        kind="share",
    )
    def blind_capture(self) -> float:
        return 1 - float(self.evaluation.exposure.max())

    @derived(
        "", "least probability of capture, for an adversary who sees the guards", "1", kind="share"
    )
    def watched_capture(self) -> float:
        return 1.0 if self.safe else 0.0

    @derived("", "largest loss from an attack: probability of success times value", kind="number")
    def risk(self) -> float:
        return float(self.evaluation.risk(self.game).max())

    @derived("", "longest time between visits to a target", kind="time")
    def longest_between(self) -> float:
        return float(self.evaluation.longest.max())

    unit = from_part("game.unit", "", "unit of time", kind="text")
    adversary = from_part("game.adversary", "", "adversary", kind="text")
    bound_between = from_part(
        "bound.between", "", "longest time between visits, at least, by any patrol", kind="time"
    )

    @derived("", "risk, at least, of any patrol", kind="number")
    def bound_risk(self) -> float | None:
        return None if self.bound is None else (1 - self.bound.capture) * self.game.value.max()

    @property
    def safe(self) -> bool:
        """`True` if no attack succeeds, whatever the adversary knows."""
        return bool((self.evaluation.exposure == 0).all())

    @property
    def answer(self) -> tuple[str, ...]:
        blind = self.game.adversary == "blind"
        first, second = self._safe(), self._weakest()
        lines = [first, *second] if blind or self.safe else [*second[::-1], self._walked(), first]
        return tuple(
            line for line in (*lines, self._bounded(), self._compared(), *self._guards()) if line
        )

    def _walked(self) -> str:
        if not self.walks_capture:
            return ""
        return (
            f"Independent random walks stop at least {percent(self.walks_capture)} of his "
            "attacks: `jaxcell patrol graph --strategy capture` finds them."
        )

    def _safe(self) -> str:
        game, longest = self.game, self.longest_between
        if not math.isfinite(longest):
            missed = np.flatnonzero(np.isinf(self.evaluation.longest))
            names = game.names_of_targets[missed[0]]
            return f"No guard ever visits `{names}`{_others(missed.size - 1)}."
        no = "At the targets that can be guarded, no" if game.unguarded else "No"
        if not longest:
            return f"{no} intruder escapes, whatever they see: a guard stays at each target."
        if self.safe and np.ptp(game.attack):
            return f"{no} intruder escapes: each target is visited before an attack on it is over."
        needed = f"{no} intruder who needs {self._time(longest, up=True)} escapes"
        if self.safe:
            needed = f"{no} intruder who needs {self._time(game.attack[0])} escapes"
        return (
            f"{needed}, whatever they see: every target is visited at least every "
            f"{self._time(longest, up=True)}."
        )

    def _weakest(self) -> list[str]:
        if self.safe:
            return []
        game, found, worst = self.game, self.evaluation, int(self.order[0])
        risk = found.risk(game)
        alike = np.isclose(risk, risk[worst], _SAME, 0) & (game.attack == game.attack[worst])
        alike &= np.isclose(found.exposure, found.exposure[worst], _SAME, 0)
        where = f"`{game.names_of_targets[worst]}`{_others(int(alike.sum()) - 1)}"
        attack = f"An attack of {self._time(game.attack[worst])} at {where}"
        share = f"{percent(found.exposure[worst])} of all moments"
        if math.isfinite(every := found.every[worst]):
            late = self._time(found.exposure[worst] * every)
            share = f"{late} of every {self._time(every, up=True)}: {share}"
        lines = [f"{attack} can succeed for {share}."]
        if np.ptp(game.value):
            lines.append(f"The largest risk, success times value, is {self.risk:.4g}.")
        if game.adversary == "watcher":
            lines.append("An adversary who sees the guards can choose such a moment, and escapes.")
        return lines

    def _bounded(self) -> str:
        if self.bound is None:
            return ""
        who = "one guard" if self.game.robots == 1 else f"{self.game.robots} guards"
        between, least = self.bound.between, self.bound_risk or 0.0
        text = f"No patrol by {who} has a shorter longest time between visits."
        if between < self.longest_between * (1 - _SAME):
            text = f"The bound is {self._time(between)}: no patrol by {who} visits all more often."
        if self.safe or not least:
            return text
        if self.risk <= least + _SAME * self.game.value.max():
            return f"{text} None has a smaller risk."
        if np.ptp(self.game.value):
            return f"{text} None has a risk below {least:.4g}."
        share = math.ceil(1000 * (1 - least / self.game.value[0]) - _SAME) / 10
        return (
            f"{text} No patrol, not even a random one, stops more than {share:.4g} % of attacks on "
            "the weakest target."
        )

    def _compared(self) -> str:
        """Say whether other schedules might stop all attacks, where these do not."""
        game, bound = self.game, self.bound
        if self.safe or bound is None or bound.capture < 1:
            return ""
        if bound.preventable is False:
            return "All schedules were compared: none stops every attack."
        if bound.preventable or (game.robots == 1 and not np.ptp(game.attack)):
            return ""
        return "Not all schedules were compared: another one may stop every attack."

    def _guards(self) -> list[str]:
        lines = []
        for number, route in enumerate(self.routes[:_GUARDS], 1):
            names = [self.game.names[vertex] for vertex in route.vertex.tolist()]
            if len(names) == 1:
                lines.append(f"Guard {number} stays at {names[0]}.")
                continue
            names = [
                f"{name} for {self._time(stay)}" if stay > 0 else name
                for name, stay in zip(names, (route.leave - route.arrive).tolist(), strict=True)
            ]
            shown = ", ".join(names[:_STOPS]) + "."
            if (left := len(names) - _STOPS) > 0:
                shown = f"{shown[:-1]}, and {left} more stops."
            begins = self._time(float(route.arrive[0])) if route.arrive[0] else ""
            lines.append(
                f"Guard {number}, every {self._time(route.period, up=True)}"
                + (f", there from {begins} on" if begins else "")
                + f": {shown}"
            )
        if (more := len(self.routes) - _GUARDS) > 0:
            lines.append(
                "1 more is in the table." if more == 1 else f"{more} more are in the table."
            )
        return lines

    @property
    def remarks(self) -> tuple[str, ...]:
        return self.left_out

    def _time(self, value: float, up: bool = False) -> str:
        """Format a time with three digits or, from 100 on, one decimal; rounded up if asked."""
        value = float(value)
        if not math.isfinite(value):
            return "never"
        digits = 1 if value >= 100 else max(1, 2 - math.floor(math.log10(value))) if value else 0
        scaled = value * 10**digits
        rounded = math.ceil(scaled * (1 - 1e-9)) if up else round(scaled)
        unit = "step" if self.game.unit == "steps" and rounded == 10**digits else self.game.unit
        return f"{rounded / 10**digits:.10g} {unit}"


def _others(count: int) -> str:
    return f" and {count} other{'s' * (count > 1)}" * (count > 0)
