import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..base import memory
from ..base.certificate import Real
from ..base.divided import of_members, start_loop
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import host_array, namespace, traced
from ..mapping.generalized import ChainLike
from ..mapping.traced import like, on_host
from .arrival import Distinct, Race


# Number of steps whose random numbers are drawn together, so that they fit into the cache.
_CHUNK = 16
# Number of runs that a lane simulates one after the other.
_TURNS = 8
# Steps are counted in 32 bits.
_MAX_STEPS = 2**30
# 95 % of a normal distribution lies within this number of standard deviations.
_NORMAL_95 = 1.959963984540054
# Peak memory of the tables, per place and image.
_BYTES_PER_SLOT = 100
# Number of digits to which probabilities must agree to count as equal.
_EQUAL = 9


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Arrivals(Pictured):
    """The times of the first arrival in many independent runs."""

    time: Float[Array, "runs"]
    "The number of steps of each run; `inf` for a run that was stopped at the horizon."
    horizon: int = dataclasses.field(metadata={"static": True})
    "The number of steps after which a run was stopped without an arrival."

    @property
    def mean(self) -> Real:
        """The mean time; `inf` if a run was stopped at the horizon."""
        mean: Any = jnp.mean(self.time)
        return mean if traced(mean) else float(mean)

    @property
    def interval(self) -> tuple[Real, Real]:
        """A confidence interval of 95 % for the expected time, from the central limit theorem.

        If a run was stopped at the horizon, the upper end is `inf`; for the lower end, this run
        counts as an arrival at the horizon.
        """
        time = namespace(self.time).minimum(self.time, self.horizon)
        error = _NORMAL_95 * time.std(ddof=1) / math.sqrt(time.size)
        low, high = time.mean() - error, self.mean + error
        return (low, high) if traced(self.time) else (float(low), float(high))


def simulate_arrival(
    key: jax.Array,
    chains: Sequence[ChainLike],
    starts: Sequence[npt.ArrayLike | int] | Distinct,
    target: npt.ArrayLike | int,
    runs: int = 5000,
    *,
    horizon: int = 100_000,
) -> Arrivals:
    """Simulate robots until the first of them reaches a set of cells (Alam 2018, section 4.4.6).

    [`jaxcell.markov.first_arrival`][] computes the law of these samples.

    **Arguments:** a random key of JAX; chains, starts and a target as for `first_arrival`; the
    number of runs; and the number of steps after which a run without an arrival is stopped.
    **Returns:** the time of each run. Chains and starts may be traced by `jit` and `vmap`; under
    `grad`, times count as constant.

    A robot that goes round in a ring of three cells:

        >>> import jax
        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> ring = mapping.Chain(np.array([[1, 2, 0]]), np.ones((1, 3)))
        >>> markov.simulate_arrival(jax.random.key(0), [ring], [0], target=2, runs=3).time.tolist()
        [2.0, 2.0, 2.0]
    """
    require_x64("simulate_arrival")
    if not isinstance(key, jax.Array):
        raise ValueError(
            f"key: expected a random key, got {type(key).__name__}; jax.random.key(0) makes one"
        )
    if runs < 2:
        raise ValueError(f"runs: expected 2 or more, got {runs}")
    if not 1 <= horizon <= _MAX_STEPS:
        raise ValueError(f"horizon: expected 1 to {_MAX_STEPS} steps, got {horizon}")
    race = Race.of(chains, starts, target)
    lanes = -(-runs // _TURNS)
    placing, walking = jax.random.split(key)
    if race.distinct:
        choices = jax.device_put(np.asarray(race.start, np.int32))
        cells = _draw_distinct_starts(placing, choices, race.robots, _TURNS * lanes)
    else:
        xp = jnp if traced(race.start) else np
        cumulative = jax.device_put(xp.cumsum(race.start, axis=1))
        cells = _draw_starts(placing, cumulative, _TURNS * lanes)
    time = _walk(walking, _Tables.of(race), cells, np.int32(horizon))
    if traced(race.chains, race.start, race.there):
        numbers = race.start, [chain.probability for chain in race.chains]
        right: Any = race.there.any()
        for each in jax.tree.leaves(numbers):
            right &= ~jnp.isnan(each).any()
        time = jnp.where(right, time, jnp.nan)
    return Arrivals(jax.device_put(host_array(time)[:runs]), horizon)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class _Tables:
    """The alias tables of all chains (Walker 1977), from which steps are sampled fast.

    The cells of all chains are numbered consecutively as *places*; the sink is one more cell of
    each chain. A place has several table entries, from which a step draws one with equal
    probability. The entry leads to the place `first` with the probability `part / 2^32`, and
    otherwise to `second`. So each step takes one random number, whatever the number of branches.
    """

    first: Int[Array, "entries"]
    second: Int[Array, "entries"]
    part: UInt32[Array, "entries"]
    there: Bool[Array, "places"]
    "The target, as a mask over the cells of all chains."
    offset: Int[Array, "robots"]
    "The place of cell 0 of each robot's chain, among the cells of all chains."

    @classmethod
    def of(cls, race: Race) -> "_Tables":
        slots = 1 + max(chain.image.shape[0] for chain in race.chains)
        places = race.there.size + 1
        memory.check(
            len(race.chains) * slots * places * _BYTES_PER_SLOT,
            f"simulate_arrival on {places - 1} cells with {slots - 1} images each",
            "first_arrival computes the law of these times in less",
        )
        entry = like(int, len(race.chains) * slots * places)
        form = entry, entry, entry.update(dtype=np.uint32)
        given = [x for c in race.chains for x in (c.image, c.probability, c.leaving)]
        tables = on_host(functools.partial(_built, slots), form, (), *given)
        there = np.tile(np.append(race.there, False), len(race.chains))
        offset = (np.array(race.robot) * places).astype(np.int32)
        return cls(*jax.device_put((*tables, there, offset)))

    def step(
        self, place: Int[Array, "robots runs"], bits: UInt32[Array, "robots runs"]
    ) -> Int[Array, "robots runs"]:
        """Return the place of each robot one step later; `bits` are 32 random bits per robot."""
        slots = self.first.size // self.there.size
        # The random number, as a fraction of 1, times the number of slots: the whole part is the
        # slot, and the fraction chooses between its two places.
        wide = bits.astype(jnp.uint64) * jnp.uint64(slots)
        entry = place * slots + (wide >> jnp.uint64(32)).astype(jnp.int32)
        within = wide.astype(jnp.uint32)
        part, first, second = (
            of_members(x, entry)[entry] for x in (self.part, self.first, self.second)
        )
        return jnp.where(within < part, first, second)


def _built(slots: int, _: tuple[()], *given: np.ndarray) -> tuple[np.ndarray, ...]:
    """Build the tables from the images, the probabilities and `leaving` of each chain."""
    images, probabilities = [], []
    for number, start in enumerate(range(0, len(given), 3)):
        branches, places = given[start].shape[0], given[start].shape[1] + 1
        # One more branch leads to the sink; unused branches stay in their cell.
        image = np.tile(np.arange(places), (slots, 1))
        image[:branches, :-1] = given[start]
        image[branches] = places - 1
        probability = np.zeros((slots, places))
        probability[:branches, :-1] = given[start + 1]
        probability[branches, :-1] = given[start + 2]
        probability[branches, -1] = 1
        images.append(image + number * places)
        probabilities.append(probability / probability.sum(axis=0))
    image, probability = np.concatenate(images, axis=1), np.concatenate(probabilities, axis=1)
    first, second, part = alias(image.T, probability.T)
    return (
        first.ravel().astype(np.int32),
        second.ravel().astype(np.int32),
        np.minimum(part.ravel() * 2.0**32, 2.0**32 - 1).astype(np.uint32),
    )


def alias(
    image: Int[np.ndarray, "places slots"], probability: Float[np.ndarray, "places slots"]
) -> tuple[
    Int[np.ndarray, "places slots"],
    Int[np.ndarray, "places slots"],
    Float[np.ndarray, "places slots"],
]:
    """Build the alias tables of many distributions at once (Walker 1977).

    The table of a row has an entry, or *slot*, for each image. Returns the first and the second
    image of each slot, and the probability of the first.
    """
    row = np.arange(len(image))
    slots = image.shape[1]
    left = probability * slots
    second, part = image.copy(), np.ones(image.shape)
    open_ = np.ones(image.shape, bool)
    for _ in range(slots - 1):
        # The least likely image shares its slot with the most likely one, and is finished. The
        # first of equally likely images is taken, so that rounding does not change the tables.
        compared = left.round(_EQUAL)
        least = np.where(open_, compared, np.inf).argmin(axis=1)
        most = np.where(open_, compared, -np.inf).argmax(axis=1)
        part[row, least] = np.minimum(left[row, least], 1)
        second[row, least] = image[row, most]
        left[row, most] -= 1 - part[row, least]
        open_[row, least] = False
    return image, second, part


@functools.partial(jax.jit, static_argnames="runs")
def _draw_starts(
    key: jax.Array, cumulative: Float[Array, "robots cells"], runs: int
) -> Int[Array, "robots {runs}"]:
    """Draw a start cell for each robot and run from cumulative probabilities."""
    drawn = jax.random.uniform(key, (len(cumulative), runs), cumulative.dtype) * cumulative[:, -1:]
    # JAX refuses the loop of its usual search if the axes of a mesh are explicit.
    method = "sort" if jax.sharding.get_abstract_mesh().explicit_axes else "scan"
    search = functools.partial(jnp.searchsorted, side="right", method=method)
    cell = jax.vmap(search)(of_members(cumulative, drawn), of_members(drawn, cumulative))
    return cell.astype(jnp.int32)


@functools.partial(jax.jit, static_argnames=("robots", "runs"))
def _draw_distinct_starts(
    key: jax.Array, choices: Int[Array, "choices"], robots: int, runs: int
) -> Int[Array, "{robots} {runs}"]:
    """Draw a set of different start cells from `choices` for each run, with Floyd's method."""
    size = choices.size
    none = jnp.full((robots, runs), -1, jnp.int32)

    def take(robot, taken):  # type: ignore[no-untyped-def]
        last = size - robots + robot
        drawn = jax.random.randint(jax.random.fold_in(key, robot), (runs,), 0, last + 1, jnp.int32)
        again = jnp.any(taken == drawn[None, :], axis=0)
        return taken.at[robot].set(jnp.where(again, last, drawn))

    taken = start_loop(none, jax.random.key_data(key))
    taken = jax.lax.fori_loop(0, robots, take, taken)
    return of_members(choices, taken)[taken]


@jax.jit
def _walk(
    key: jax.Array, tables: _Tables, cells: Int[Array, "robots runs"], horizon: Int[Array, ""]
) -> Float[Array, "runs"]:
    """Simulate all runs from the start `cells` until an arrival or the horizon; return the times.

    Each of many parallel *lanes* simulates several runs one after the other, because parallel runs
    would all wait for the longest run, which takes several times the mean.
    """
    robots, turns, lanes = len(cells), _TURNS, cells.shape[1] // _TURNS
    start = (tables.offset[:, None] + cells).reshape(robots, turns, lanes)
    lane = jnp.arange(lanes)

    def going_on(state):  # type: ignore[no-untyped-def]
        return jnp.any(state[1] < turns)

    def chunk(state):  # type: ignore[no-untyped-def]
        drawn = jax.random.fold_in(key, state[-1])
        bits = jax.random.bits(drawn, (_CHUNK, robots, lanes), jnp.uint32)
        *state, count = state
        return *jax.lax.scan(move, tuple(state), bits)[0], count + 1

    def move(state, bits):  # type: ignore[no-untyped-def]
        place, turn, step, time = state
        arrived = jnp.any(of_members(tables.there, place)[place], axis=0)
        ends = arrived | (step >= horizon)
        taken = jnp.where(arrived, step.astype(time.dtype), jnp.inf)
        now = (jnp.arange(turns, dtype=jnp.int32)[:, None] == turn[None, :]) & ends[None, :]
        time = jnp.where(now, taken[None, :], time)
        turn = turn + ends.astype(jnp.int32)
        other = of_members(start, turn)[:, jnp.minimum(turn, turns - 1), lane]
        place = jnp.where(ends[None, :], other, tables.step(place, bits))
        return (place, turn, jnp.where(ends, 0, step + 1), time), None

    none = jnp.zeros(lanes, jnp.int32)
    state = (start[:, 0], none, none, jnp.zeros((turns, lanes)), jnp.int32(0))
    state = start_loop(state, jax.random.key_data(key), tables, cells, horizon)
    return jax.lax.while_loop(going_on, chunk, state)[3].ravel()
