import dataclasses
import functools
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate
from ..base.quantities import Result, derived, from_part, quantity
from ..base.shown import Shown
from ..mapping import Chain
from ..mapping.sequence import check_steps
from ..markov.conditional import arrival_probabilities, conditional_hitting_times
from ..markov.decision import DecisionModel, policy_chain
from ..markov.discounted import Optimum, value_iteration
from ..markov.hitting import cell_mask
from ..markov.passage import start_distribution
from ..markov.shortest_path import ShortestPath, stochastic_shortest_path
from .layered_cells import Sea


# The actions of Alam 2018, section 5.3.2: drift, up, and down. The first of equally good actions is
# taken, so that drifters change their depth only if it is useful.
ACTIONS = (0, -1, 1)
_ARRIVAL_REWARD = 100.0
_STEP_REWARD = -1.0
_squares = functools.partial(derived, "layer y x")


@dataclasses.dataclass(frozen=True, eq=False)
class Voyage(Shown):
    """A policy that brings a drifter to a goal, and its probabilities and times of arrival."""

    goal: Bool[np.ndarray, "cells"]
    actions: Int[Array, "phases cells"]
    """The action at each phase in each cell: -1 up, 1 down, 0 drift (and in the goal). The fields
    from `probability` to `value` are for drifters that begin at phase 0."""
    chain: Chain
    """The chain of a drifter that follows the actions and stays in the goal. Its states are the
    cells at each phase, phase after phase."""
    probability: Float[Array, "cells"]
    "The probability that a drifter from each cell ever arrives."
    time: Float[Array, "cells"]
    "The expected number of steps to arrive; `inf` for cells from which the drifter may fail."
    conditional_time: Float[Array, "cells"]
    "The expected number of steps of drifters that arrive; `inf` for cells from which none arrives."
    value: Float[Array, "cells"] | None
    "The value function; `None` for the surest voyage, which has no discount."
    certificate: Certificate
    """The error of the policy, from [`jaxcell.markov.Optimum`][] or
    [`jaxcell.markov.ShortestPath`][]."""
    arrival: Certificate
    "The error of `conditional_time`, from [`jaxcell.markov.conditional_hitting_times`][]."

    @property
    def action(self) -> Int[Array, "cells"]:
        """The action in each cell at phase 0."""
        return jax.device_put(np.asarray(self.actions)[0])


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks(Shown):
    """The tracks of simulated drifters."""

    cell: Int[Array, "times drifters"]
    "The cell after 0, 1, 2, ... steps; -1 once the drifter has left the map."
    time: Float[Array, "drifters"]
    "The number of steps until the drifter arrived, or `inf`."

    @property
    def arrived(self) -> Bool[Array, "drifters"]:
        """The mask of the drifters that arrived."""
        return jnp.isfinite(self.time)


def voyage_model(sea: Sea, goal: npt.ArrayLike | int, discount: float) -> DecisionModel:
    """Build the decision model of a drifter with a goal (Alam 2018, section 5.4.7).

    The actions are, in this order, drift (0), up (-1) and down (1). A move up or down takes one
    step, in which the drifter does not drift; there must be a cell above or below.

    The reward is 100 for a step that leads to the goal, and -1 otherwise (Eq. 5.10); so its mean is
    `101 p - 1` for a step that leads to the goal with probability `p`. The dissertation defines no
    reward after an arrival or after leaving the map. Here the voyage ends with the arrival, without
    further reward. A drifter off the map pays 1 per step, as on the map; otherwise it would be
    better to leave.

    **Arguments:**

    - `sea`: the layers.
    - `goal`: a cell, several cells, or a mask over the cells.
    - `discount`: the discount factor per step; leaving the map costs `1 / (1 - discount)`.

    **Returns:** the model, for [`jaxcell.markov.value_iteration`][].

    Two layers of three cells: water flows East at the surface, and West below it.
    The goal is cell 0; going up from cell 3, directly below the goal, has the reward 100:

        >>> from jaxcell import drift, examples
        >>> sea = examples.sea()
        >>> model = drift.voyage_model(sea, 0, discount=0.9)
        >>> round(float(model.reward[:, 3].max()), 6)
        100.0
    """
    if not 0 < discount < 1:
        raise ValueError(f"discount: expected more than 0 and less than 1, got {discount}")
    in_goal = _at_goal(sea, goal)
    chains, allowed = _actions(sea)
    # From the goal every action leads to the sink.
    ended = [Chain(chain.image, np.where(in_goal, 0, chain.probability)) for chain in chains]
    arrives = np.stack([chain.to_scipy() @ in_goal for chain in chains])
    lost = np.stack([chain.leaving for chain in chains])
    reward = _STEP_REWARD + (_ARRIVAL_REWARD - _STEP_REWARD) * arrives
    reward = reward + _STEP_REWARD * discount / (1 - discount) * lost
    return DecisionModel.of(ended, np.where(in_goal, 0, reward), allowed)


def discounted_voyage(sea: Sea, goal: npt.ArrayLike | int, discount: float = 0.99) -> Voyage:
    """Compute the navigation policy of Alam 2018, Alg. 5.5, with value iteration.

    With a discount the policy may prefer a quick path that often fails;
    [`surest_voyage`][jaxcell.drift.surest_voyage] avoids this.

    **Arguments:**

    - `sea`: the layers.
    - `goal`: a cell, several cells, or a mask over the cells.
    - `discount`: the discount factor per step, more than 0 and less than 1; the dissertation does
        not name its value.

    **Returns:** the voyage. If an eddy almost traps drifters, even 64-bit numbers give inaccurate
    results, as `certificate` and `arrival` then show.

    Two layers of three cells: at the surface everything drifts East, below it West.
    To reach the goal, cell 0, a drifter goes down (1), drifts (0) and comes up (-1):

        >>> from jaxcell import drift, examples
        >>> sea = examples.sea()
        >>> voyage = drift.discounted_voyage(sea, 0)
        >>> voyage.action.tolist(), voyage.time.round(6).tolist()
        ([0, 1, 1, -1, 0, 0], [0.0, 3.0, 4.0, 1.0, 2.0, 3.0])
        >>> voyage.value.round(3).tolist()
        [0.0, 95.06, 93.119, 99.0, 97.02, 95.06]
    """
    model = voyage_model(sea, goal, discount)
    best = value_iteration(model, discount, throw=False)
    return _voyage(sea, _at_goal(sea, goal), model, best, best.value)


def surest_voyage(sea: Sea, goal: npt.ArrayLike | int) -> Voyage:
    """Compute the quickest of the policies that arrive with the largest probability.

    **Arguments:** the layers; and the goal: a cell, several cells, or a mask over the cells.
    **Returns:** the voyage, without a value function.

    **Raises:** `ValueError` for a goal that is empty or not on the map; `RuntimeError` if the
    policy iteration does not converge.

    Two layers of three cells: at the surface everything drifts East, below it West.
    To reach the goal, cell 0, a drifter goes down (1), drifts (0) and comes up (-1):

        >>> from jaxcell import drift, examples
        >>> voyage = drift.surest_voyage(examples.sea(), 0)
        >>> voyage.action.tolist(), voyage.probability.tolist()
        ([0, 1, 1, -1, 0, 0], [1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    """
    in_goal = _at_goal(sea, goal)
    chains, allowed = _actions(sea)
    model = DecisionModel.of(chains, np.zeros(allowed.shape), allowed)
    best = stochastic_shortest_path(model, in_goal, throw=False)
    return _voyage(sea, in_goal, model, best, None)


def simulate_voyages(
    key: jax.Array, voyage: Voyage, start: npt.ArrayLike | int, drifters: int, steps: int
) -> Tracks:
    """Simulate independent drifters that follow a voyage.

    **Arguments:**

    - `key`: a key of `jax.random`.
    - `voyage`: the policy.
    - `start`: a cell; several cells or a mask, from which a cell is drawn for each drifter; or the
        probability of each cell, as floating-point numbers.
    - `drifters`: number of drifters.
    - `steps`: number of steps.

    **Returns:** [`Tracks`][jaxcell.drift.Tracks].

    Two layers of three cells: at the surface everything drifts East, below it West.
    A drifter from cell 2 to cell 0 goes down, West twice, and up:

        >>> import jax
        >>> from jaxcell import drift, examples
        >>> sea = examples.sea()
        >>> voyage = drift.surest_voyage(sea, 0)
        >>> tracks = drift.simulate_voyages(jax.random.key(0), voyage, 2, drifters=1, steps=5)
        >>> tracks.cell[:, 0].tolist(), tracks.time.tolist()
        ([2, 5, 4, 3, 0, 0], [4.0])
    """
    check_steps(steps)
    if drifters < 1:
        raise ValueError(f"drifters: expected 1 or more, got {drifters}")
    cells, random = voyage.goal.size, np.random.default_rng(np.asarray(jax.random.key_data(key)))
    image, probability = np.asarray(voyage.chain.image), np.asarray(voyage.chain.probability)
    total, likeliest = probability.cumsum(axis=0), probability.argmax(axis=0)
    # A draw beyond the sum of all branches goes to the sink; if the cell has no sink, the cause is
    # rounding, and the draw goes to the likeliest branch.
    past = np.where(voyage.chain.can_leave, -1, image[likeliest, np.arange(likeliest.size)])
    state = random.choice(cells, drifters, p=start_distribution(cells, start))
    places = [state.astype(np.int32)]
    for _ in range(steps):
        within = random.random(drifters) < total[:, state]
        moved = np.where(within.any(axis=0), image[within.argmax(axis=0), state], past[state])
        state = np.where(state < 0, -1, moved)
        places.append(np.where(state < 0, -1, state % cells).astype(np.int32))
    cell = np.stack(places)
    in_goal = np.asarray(voyage.goal)[cell] & (cell >= 0)
    time = np.where(in_goal.any(axis=0), in_goal.argmax(axis=0), np.inf)
    return Tracks(jax.device_put(cell), jax.device_put(time))


@dataclasses.dataclass(frozen=True, eq=False)
class SeaVoyage(Result):
    """The voyages to a goal under one policy, with probabilities and times of arrival."""

    sea: Sea
    policy: Voyage
    hours: float
    "The duration of a step, in hours."
    goal: Annotated[
        tuple[float, float, float],
        quantity("place", "longitude, latitude and depth of the goal", listed=True),
    ]
    start: int | None = None
    "The cell where a drifter is dropped; `None` if there is no start."

    @property
    def arrives(self) -> bool:
        """True if a drifter from the start may arrive, or if there is no start."""
        return self.start_probability is None or self.start_probability > 0

    @derived("", "probability of arriving from the start", kind="share")
    def start_probability(self) -> float | None:
        return self._at_start(self.policy.probability)

    @derived("", "time from the start; infinite if it may fail", "h", kind="time")
    def start_hours(self) -> float | None:
        return self._at_start(np.asarray(self.policy.time) * self.hours)

    @derived("", "time from the start, if it arrives", "h", kind="time")
    def start_hours_if_it_arrives(self) -> float | None:
        return self._at_start(np.asarray(self.policy.conditional_time) * self.hours)

    def _at_start(self, values: npt.ArrayLike) -> float | None:
        return None if self.start is None else float(np.asarray(values)[self.start])

    @derived("", "probability of arriving, mean over all cells", kind="share")
    def mean_probability(self) -> float:
        return float(np.asarray(self.policy.probability).mean())

    @derived("", "cells that arrive for sure", kind="count")
    def cells_that_arrive_for_sure(self) -> int:
        return int((np.asarray(self.policy.probability) == 1).sum())

    @derived("", "mean time of these cells", "h", kind="time")
    def their_mean_hours(self) -> float:
        sure = np.asarray(self.policy.probability) == 1
        return float(np.asarray(self.policy.time)[sure].mean()) * self.hours

    @derived("", "choices of a policy", kind="count")
    def iterations(self) -> int | None:
        return None if self.policy.value is None else self.policy.certificate.iterations

    @derived("", "bound of the error of a value, relative to the largest", kind="residual")
    def value_error(self) -> float | None:
        return None if self.policy.value is None else self.policy.certificate.residual

    policy_certified = from_part(
        "policy.certificate.converged", "", "whether the policy is certified", kind="flag"
    )
    times_certified = from_part(
        "policy.arrival.converged", "", "whether all times are certified", kind="flag"
    )

    @_squares(
        "action of the drifter",
        padding="-2: no water",
        meaning_of_values="-1: up, 0: drift, 1: down",
    )
    def action(self) -> Int[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(self.policy.action, -2)

    @_squares("value function", "1", padding="NaN: no water")
    def value(self) -> Float[np.ndarray, "layers rows columns"] | None:
        return None if self.policy.value is None else self.sea.on_squares(self.policy.value)

    @_squares("probability of arriving", "1", kind="share", padding="NaN: no water")
    def arrival_probability(self) -> Float[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(self.policy.probability)

    @_squares("expected time to arrive; inf where it may fail", "h", kind="time")
    def arrival_time(self) -> Float[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(np.asarray(self.policy.time) * self.hours)

    @_squares("expected time to arrive, if it arrives", "h", kind="time")
    def conditional_arrival_time(self) -> Float[np.ndarray, "layers rows columns"]:
        return self.sea.on_squares(np.asarray(self.policy.conditional_time) * self.hours)


def _actions(sea: Sea) -> tuple[list[Chain], Bool[np.ndarray, "actions states"]]:
    """Return the chains of the actions, and the states in which each action can be taken."""
    anywhere = np.ones(sea.cells, bool)
    chains = [sea.drift, Chain.from_scipy(sea.ascent), Chain.from_scipy(sea.descent)]
    return chains, np.tile([anywhere, sea.above >= 0, sea.below >= 0], sea.phases)


def _at_goal(sea: Sea, goal: npt.ArrayLike | int) -> Bool[np.ndarray, "states"]:
    return np.tile(cell_mask(sea.cells, goal, "goal"), sea.phases)


def _voyage(
    sea: Sea,
    in_goal: Bool[np.ndarray, "states"],
    model: DecisionModel,
    best: Optimum | ShortestPath,
    value: Float[Array, "states"] | None,
) -> Voyage:
    taken = np.where(in_goal, np.int32(0), best.policy)
    loop = policy_chain(model, jax.device_put(taken))
    stay = np.arange(loop.image.shape[0])[:, None] == 0
    chain = Chain(
        np.where(in_goal, np.arange(in_goal.size, dtype=np.int32), loop.image),
        np.where(in_goal, stay.astype(np.float64), loop.probability),
    )

    def begins(values: npt.ArrayLike) -> np.ndarray:
        return np.asarray(values)[: sea.cells]

    probability = begins(arrival_probabilities(chain, in_goal, throw=False).value)
    arrival = conditional_hitting_times(chain, in_goal, throw=False)
    conditional = begins(arrival.value)
    return Voyage(
        begins(in_goal),
        jax.device_put(np.array(ACTIONS, np.int32)[taken].reshape(sea.phases, sea.cells)),
        chain,
        jax.device_put(probability),
        jax.device_put(np.where(probability == 1, conditional, np.inf)),
        jax.device_put(conditional),
        None if value is None else jax.device_put(begins(value)),
        best.certificate,
        arrival.certificate,
    )
