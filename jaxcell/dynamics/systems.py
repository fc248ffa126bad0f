"""Seven example systems for `jaxcell dynamics`, which also runs systems from other files:

jaxcell dynamics pendulum --params T=0.5 --out runs/pendulum
jaxcell dynamics my_systems.py:pendulum --params T=0.01:0.96:20
"""

import jax.numpy as jnp
import numpy as np

from ..space.box import Box
from .maps import flow, strobe
from .system import System


def _duffing(t, x, p):  # type: ignore[no-untyped-def]
    return jnp.stack([x[1], -0.25 * x[1] - 0.05 * x[0] - x[0] ** 3 + p["force"] * jnp.cos(t)])


duffing = System(
    strobe(_duffing, 2 * np.pi, steps=50),
    Box([1.6, -3.5], [3.6, 5.5], cells=[151, 151]),
    {"force": 8.5},
    ("position", "speed"),
    "Ueda's oscillator x'' = -0.25 x' - 0.05 x - x^3 + force cos t, once a period of the force.",
)


def _pendulum(x, p):  # type: ignore[no-untyped-def]
    return jnp.stack([x[1], p["T"] - p["damping"] * x[1] - jnp.sin(x[0])])


pendulum = System(
    flow(_pendulum, dt=0.05, steps=40),
    Box([-np.pi, -10], [np.pi, 10], cells=[401, 401], axes=["periodic", "sink"]),
    {"T": 0.5, "damping": 0.1},
    ("angle (rad)", "speed (rad/s)"),
    "A pendulum with a constant torque T: at rest, or going round.",
)


def _henon(x, p):  # type: ignore[no-untyped-def]
    return jnp.stack([1 - p["a"] * x[0] ** 2 + x[1], p["b"] * x[0]])


henon = System(
    _henon,
    Box([-2, -2], [2, 2], cells=[501, 501]),
    {"a": 1.4, "b": 0.3},
    ("x", "y"),
    "Henon's map (1 - a x^2 + y, b x).",
)

_ANGLES = 2 * np.pi * np.arange(3) / 3
_MAGNETS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def _magnetic(x, p):  # type: ignore[no-untyped-def]
    place, speed = x[:2], x[2:]
    apart = jnp.asarray(_MAGNETS) - place[None]
    distance = jnp.sqrt(jnp.sum(apart**2, axis=1) + p["height"] ** 2)
    pull = jnp.sum(p["pull"] * apart / distance[:, None] ** 3, axis=0)
    return jnp.concatenate([speed, pull - p["omega"] ** 2 * place - p["damping"] * speed])


magnetic = System(
    flow(_magnetic, dt=0.05, steps=20),
    Box([-2, -2, -2, -2], [2, 2, 2, 2], cells=[41, 41, 41, 41]),
    {"damping": 0.2, "omega": 0.8, "height": 0.2, "pull": 1.0},
    ("x", "y", "speed along x", "speed along y"),
    "A pendulum over three magnets.",
)


def _lorenz84(x, p):  # type: ignore[no-untyped-def]
    west, cos, sin = x[0], x[1], x[2]
    zonal = -(cos**2) - sin**2 - p["a"] * west + p["a"] * p["F"]
    first = west * cos - cos - p["b"] * west * sin + p["G"]
    return jnp.stack([zonal, first, p["b"] * west * cos + west * sin - sin])


lorenz84 = System(
    flow(_lorenz84, dt=0.02, steps=50),
    Box([-3, -3, -3], [3, 3, 3], cells=[101, 101, 101]),
    {"F": 6.886, "G": 1.347, "a": 0.255, "b": 4.0},
    ("x", "y", "z"),
    "Lorenz' model of the general circulation of 1984: three attractors at these parameters.",
)


def _thomas(x, p):  # type: ignore[no-untyped-def]
    return jnp.stack([jnp.sin(x[(k + 1) % 3]) - p["b"] * x[k] for k in range(3)])


thomas = System(
    flow(_thomas, dt=0.1, steps=20),
    Box([-6, -6, -6], [6, 6, 6], cells=[101, 101, 101]),
    {"b": 0.1665},
    ("x", "y", "z"),
    "Thomas' cyclically symmetric system.",
)


def _well(x, p):  # type: ignore[no-untyped-def]
    return p["a"] * x - x**3


well = System(
    flow(_well, dt=0.05, steps=20),
    Box([-2.5], [2.5], cells=[200], axes="clamp"),
    {"a": 1.0},
    ("x",),
    "A particle in a double well, x' = a x - x^3.",
)
