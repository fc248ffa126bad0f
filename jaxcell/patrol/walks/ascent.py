import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from ...base.threads import one_blas_thread
from ...optimize import Graph
from .steps import Steps, chances, pull


_STEPS, _BLOCK = 1200, 25
# Vertices from which on there are half as many, which take half a minute on 400.
_LARGE = 200
# Of the steps on the logits, and of the soft minimum of the logarithms of capture.
_RATE, _SOFT, _HARD = 0.1, 1.0, 300.0
# Least probability of a step.
_FLOOR = 1e-6


@one_blas_thread()
def ascend(
    graph: Graph, attack_time: int, starts: Float[np.ndarray, "starts robots vertices vertices"]
) -> tuple[Float[np.ndarray, "robots vertices vertices"], int, int, float]:
    """Follow the gradient of the least probability of capture in the logits of the steps.

    Adam anneals the minimum from each start. What the best then lacks of a local optimum is left to
    linear programs.

    **Arguments:**

    - `graph`: a connected graph whose edges take one step each.
    - `attack_time`: the steps that an attack takes.
    - `starts`: transition matrices without waiting.

    **Returns:** the matrices of the robots, the start that led there, the number of steps, and the
    share of the probability that the last quarter of them added.
    """
    steps, count = Steps.of(graph), _STEPS // (1 + (graph.vertices > _LARGE))
    here = np.arange(graph.vertices)
    found = []
    for start in starts:
        logits = np.log(np.maximum(start[:, here, np.asarray(steps.image)], 1e-3))
        found.append(_climb(logits, steps, attack_time, count))
    first = int(np.argmax([course[-1] for _, course in found]))
    best, course = found[first]
    drawn = np.asarray(chances(jnp.asarray(best, jnp.float64), steps, _FLOOR))
    matrices = np.zeros((len(drawn), graph.vertices, graph.vertices))
    for matrix, chance in zip(matrices, drawn, strict=True):
        np.add.at(matrix, (np.broadcast_to(here, chance.shape), np.asarray(steps.image)), chance)
    late = 1 - course[-len(course) // 4] / max(course[-1], 1e-12)
    return matrices, first, count * len(starts), late


def _climb(logits, steps, attack_time, count):  # type: ignore[no-untyped-def]
    """The best logits, and how the value rises."""
    best = jnp.asarray(logits, jnp.float32)
    state = best, optax.scale_by_adam().init(best)
    course = [float(_least(best, steps, attack_time))]
    progress = np.arange(count) / count
    rate = _RATE * 0.5 * (1 + np.cos(np.pi * progress))
    hardness = _SOFT * (_HARD / _SOFT) ** progress
    for first in range(0, count, _BLOCK):
        block = slice(first, first + _BLOCK)
        schedule = jnp.asarray(rate[block], jnp.float32), jnp.asarray(hardness[block], jnp.float32)
        state = _follow(*state, steps, schedule, attack_time)
        now = float(_least(state[0], steps, attack_time))
        best = state[0] if now > course[-1] else best
        course.append(max(now, course[-1]))
    return best, course


def _captured(
    logits: Float[Array, "robots branches vertices"], steps: Steps, attack_time: int
) -> Float[Array, "robots vertices vertices"]:
    """The probability that each robot comes from each start to each target in time."""
    away = 1 - jnp.eye(logits.shape[2], dtype=logits.dtype)

    def one(chance):  # type: ignore[no-untyped-def]
        def step(late, _):  # type: ignore[no-untyped-def]
            return away * pull(chance, late, steps), None

        late, _ = jax.lax.scan(step, away, length=attack_time - 1)
        return 1 - pull(chance, late, steps)

    return jnp.stack([one(chance) for chance in chances(logits, steps, _FLOOR)])


@functools.partial(jax.jit, static_argnames="attack_time")
def _least(logits, steps, attack_time):  # type: ignore[no-untyped-def]
    worst = jnp.min(_captured(logits, steps, attack_time), axis=1)
    return jnp.min(1 - jnp.prod(1 - worst, axis=0))


@functools.partial(jax.jit, static_argnames="attack_time")
def _follow(logits, moments, steps, schedule, attack_time):  # type: ignore[no-untyped-def]
    adam = optax.scale_by_adam()

    def loss(logits, hardness):  # type: ignore[no-untyped-def]
        captured = jnp.maximum(_captured(logits, steps, attack_time), 1e-12)
        worst = -jax.nn.logsumexp(-hardness * jnp.log(captured), axis=1) / hardness
        if logits.shape[0] > 1:
            missed = jnp.sum(jnp.log1p(-jnp.exp(jnp.minimum(worst, -1e-6))), axis=0)
            worst = jnp.log(-jnp.expm1(missed))[None]
        return jax.nn.logsumexp(-hardness * worst) / hardness

    def step(state, now):  # type: ignore[no-untyped-def]
        logits, moments = state
        rate, hardness = now
        change, moments = adam.update(jax.grad(loss)(logits, hardness), moments)
        return (logits - rate * change, moments), None

    with jax.numpy_dtype_promotion("standard"):
        return jax.lax.scan(step, (logits, moments), schedule)[0]
