import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...space import Slip, slipping_step
from ...space.slip import ERRORS, MISSED
from .fine_cells import jax_free_ahead


@functools.partial(jax.jit, static_argnames=("shift", "slip", "directions"))
def particle_run(
    pose: Float[Array, "particles 3"],
    believed: Int[Array, "particles"],
    observations: Int[Array, "times"],
    key: Array,
    legs: Float[Array, "directions 3"],
    walls: Float[Array, "walls 2 2"],
    *,
    shift: int,
    slip: Slip,
    directions: int,
) -> tuple[Float[Array, "times particles 3"], Float[Array, "times"]]:
    """Monte Carlo localization of a whole run, `jaxcell.robot.Particles` for studies.

    Works under `vmap` over the observations and the key.

    **Arguments:**

    - `pose`, `believed`: where the particles start, and the directions that they believe.
    - `observations`: 0 or 1 each.
    - `key`: of the errors.
    - `legs`, `walls`: of [`jaxcell.space.stride_legs`][] and [`jaxcell.space.felt_walls`][].
    - `shift`: the bouncing angle, as a number of directions.
    - `slip`: how large the errors are.
    - `directions`: number of directions.

    **Returns:** the particles after each observation, and the share that it did not refute.

    In a corridor of three cells, all particles that go East to the end and turn there look West:

        >>> import jax
        >>> import numpy as np
        >>> from jaxcell import bounce, examples, space
        >>> room = examples.corridor().workspace
        >>> walls, legs = space.felt_walls(room, 0.0), space.stride_legs(2, 1.0, 1.0)
        >>> pose, east = np.tile([1.5, 0.5, 0.0], (5, 1)), np.zeros(5, int)
        >>> after, matched = bounce.particle_run(
        ...     pose, east, np.array([0, 1]), jax.random.key(0), legs, walls,
        ...     shift=1, slip=space.Slip(), directions=2,
        ... )
        >>> after[-1, 0].round(2).tolist(), matched.tolist()
        ([2.5, 0.5, 3.14], [1.0, 1.0])
    """
    turn = 2 * math.pi * shift / directions

    def observe(state, step):  # type: ignore[no-untyped-def]
        pose, believed = state
        observation, key = step
        noise, draw = jax.random.split(key)
        errors = jax.random.normal(noise, (pose.shape[0], ERRORS))
        pose, bumped = slipping_step(
            pose, legs[believed], turn, errors, walls, slip, ahead_of=jax_free_ahead
        )
        believed = jnp.where(bumped, believed + shift, believed) % directions
        match = bumped == (observation == 1)
        ends = jnp.cumsum(jnp.where(match, 1.0, MISSED))
        count = pose.shape[0]
        drawn = (jnp.arange(count, dtype=ends.dtype) + jax.random.uniform(draw)) / count * ends[-1]
        kept = jnp.minimum(jnp.searchsorted(ends, drawn, side="right"), count - 1)
        return (pose[kept], believed[kept]), (pose[kept], match.mean())

    keys = jax.random.split(key, observations.shape[0])
    return jax.lax.scan(observe, (pose, believed), (observations, keys))[1]
