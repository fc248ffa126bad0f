import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell.dynamics.sines import with_sines


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sines_equal_those_of_the_library(name, dtype):
    rng = np.random.default_rng(0)
    angles = np.concatenate([rng.uniform(-far, far, 20_000) for far in (1e-3, 4.0, 6e4)])
    angles = np.concatenate([angles, np.arange(-9, 9) * np.pi / 2]).astype(dtype)
    found = jax.jit(with_sines(getattr(jnp, name)))(angles)
    assert found.dtype == dtype
    right = getattr(np, name)(angles.astype(np.longdouble))
    assert np.abs(np.asarray(found) - right).max() < 2 * np.finfo(dtype).eps
    far = np.asarray([np.inf, np.nan, 1e30], dtype)
    ends = np.asarray(jax.jit(with_sines(getattr(jnp, name)))(far))
    assert np.isnan(ends[:2]).all()
    assert abs(float(ends[2])) <= 1


def test_only_sines_of_a_function_are_replaced():
    @jax.jit
    def inner(x):
        return jnp.sin(x) + jnp.where(x > 0, jnp.cos(x), 2.0)

    def field(x, p):
        turned = jax.lax.fori_loop(0, 2, lambda _, y: jnp.sin(y), x[0])
        return {"a": inner(x) * p["T"], "b": (turned, jnp.exp(x), 3)}

    given = jnp.array([0.5, -2.0]), {"T": 0.25}
    found, right = with_sines(field)(*given), field(*given)
    assert jax.tree.structure(found) == jax.tree.structure(right)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(right), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15, atol=1e-15)
    compiled = jax.jit(with_sines(field)).lower(*given).compile().as_text()
    assert " sine(" not in compiled
    assert " cosine(" not in compiled
