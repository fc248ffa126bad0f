import dataclasses
import itertools
from typing import Any, TypeAlias

import jax
import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate
from ..base.precision import require_x64
from ..base.process import no_output
from ..base.shown import Shown
from .validation import distribution, finite


# Tolerance relative to the range of payoffs: HiGHS meets constraints of integer programs to 1e-6.
_TOLERANCE = 1e-6
# The smallest tolerances of a linear program that HiGHS allows.
_LP_OPTIONS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
_MAX_PROFILES = 10_000


_Payoffs: TypeAlias = Float[np.ndarray, "types strategies targets"]
_Weights: TypeAlias = Float[np.ndarray, "strategies"]


@dataclasses.dataclass(frozen=True, eq=False)
class Commitment(Shown):
    """The best mixture of the leader's strategies, and the answer of the follower to it."""

    weights: Float[Array, "strategies"]
    "The weight of each strategy of the leader. Weights are not negative and sum to 1."
    answer: Int[Array, "types"]
    "The target that each type of the follower chooses."
    value: float
    "The expected payoff of the leader."
    follower_value: Float[Array, "types"]
    "The expected payoff of each type of the follower."
    certificate: Certificate


def stackelberg(
    leader: Any,
    follower: Any,
    prior: Any = None,
    *,
    method: str | None = None,
    time_limit: float = 60.0,
    throw: bool = True,
) -> Commitment:
    """Find the best mixture to which a leader can commit, if a follower answers to the mixture.

    It runs on the host, because HiGHS solves the programs.

    The leader mixes its strategies. Each type of the follower knows the mixture and chooses the
    target with its largest payoff, and among equal targets the best for the leader (a strong
    Stackelberg equilibrium; Alam 2018, section 4.4.2). The leader knows only the probability of
    each type.

    Two methods find the same value. `"dobss"` is one mixed-integer program (Paruchuri et al. 2008).
    `"multiple-lp"` solves one linear program per combination of answers of the types (Conitzer and
    Sandholm 2006).

    **Arguments:**

    - `leader`: array `[strategies, targets]`, the payoff of the leader; or `[types, strategies,
        targets]` if it depends on the type of the follower.
    - `follower`: the payoff of the follower, in an array of the same kind.
    - `prior`: array `[types]`, the probability of each type; by default all are equal.
    - `method`: `"dobss"` or `"multiple-lp"`; by default `"multiple-lp"` for one type, and `"dobss"`
        for several types, followed by `"multiple-lp"` if the residual is too large and there are at
        most 10,000 combinations.
    - `time_limit`: time limit of the mixed-integer program, in seconds. When it is reached, the
        result is the best commitment so far, and the residual bounds its error.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`Commitment`][]. The residual of its certificate is the larger of two numbers. One
    is the excess of an upper bound on all commitments over the value, relative to the range of the
    leader's payoffs. The other is the most that a type gains by another target, relative to the
    largest difference of its payoffs under one strategy. Differences below the tolerance may count
    as 0. Iterations are the nodes of the branch and bound, or the linear programs.

    Mixing pays for the leader, whose first strategy alone would have the payoff 2 (Conitzer and
    Sandholm 2006):

        >>> from jaxcell import optimize
        >>> best = optimize.stackelberg([[2, 4], [1, 3]], [[1, 0], [0, 1]])
        >>> best.weights.round(6).tolist(), best.answer.tolist(), round(best.value, 6)
        ([0.5, 0.5], [1], 3.5)
    """
    require_x64("stackelberg")
    R, C = _payoffs("leader", leader), _payoffs("follower", follower)
    if R.shape[1:] != C.shape[1:]:
        raise ValueError(
            f"leader and follower: expected the same [strategies, targets], got "
            f"{list(R.shape[1:])} and {list(C.shape[1:])}"
        )
    types = max(len(R), len(C))
    for name, payoffs in (("leader", R), ("follower", C)):
        if len(payoffs) not in (1, types):
            raise ValueError(f"{name}: expected payoffs of {types} types, got {len(payoffs)}")
    R, C = (np.broadcast_to(payoffs, (types, *payoffs.shape[1:])) for payoffs in (R, C))
    probability = np.full(types, 1 / types)
    if prior is not None:
        probability = distribution("prior", prior, types, "per type", zero=True)
    if method not in (None, "dobss", "multiple-lp"):
        raise ValueError(f"method: expected one of ['dobss', 'multiple-lp'], got {method!r}")
    if not time_limit > 0:
        raise ValueError(f"time_limit: expected more than 0 s, got {time_limit}")

    # The answer of a type depends neither on the scale nor on payoffs shared by all targets.
    unit_R = _unit(R - R.min())
    unit_C = np.stack([_unit(payoff - payoff.min(axis=1, keepdims=True)) for payoff in C])
    paid = probability[:, None, None] * unit_R
    each = np.arange(types)

    def certified(solved: _Solved) -> tuple[_Solved, Certificate]:
        weights, answer, bound, iterations = solved
        value = float(probability @ (weights @ unit_R)[each, answer])
        replies = weights @ unit_C
        regret = float((replies.max(axis=1) - replies[each, answer]).max())
        return solved, Certificate(iterations, max(0.0, bound - value, regret), _TOLERANCE)

    if method == "multiple-lp" or (method is None and types == 1):
        solved, certificate = certified(_multiple_lp(paid, unit_C))
    else:
        solved, certificate = certified(_dobss(paid, unit_C, time_limit))
        few = C.shape[2] ** types <= _MAX_PROFILES
        if method is None and few and not certificate.converged:
            solved, certificate = certified(_multiple_lp(paid, unit_C))
    certificate.check("stackelberg", throw)
    weights, answer, *_ = solved
    value = float(probability @ (weights @ R)[each, answer])
    gained = (weights @ C)[each, answer]
    weights, answer, gained = jax.device_put((weights, answer, gained))
    return Commitment(weights, answer, value, gained, certificate)


# A commitment, its answers, an upper bound on the value of all commitments, and the iterations.
_Solved = tuple[_Weights, Int[np.ndarray, "types"], float, int]


def _dobss(R: _Payoffs, C: _Payoffs, time_limit: float) -> _Solved:
    """Solve the mixed-integer program DOBSS for payoffs `R` of the leader and `C` of the follower.

    Its variables are the leader's weights `x`, the value `a` and the best response `q` of each type
    of follower, and `z = x q`.
    """
    types, strategies, targets = C.shape
    eye, ones = scipy.sparse.eye_array, np.ones
    C_of_x = scipy.sparse.csr_array(C.transpose(0, 2, 1).reshape(types * targets, strategies))
    a_of_type = scipy.sparse.kron(eye(types), ones((targets, 1)))
    # The largest loss of a type that answers with a target, relative to its best answer.
    most = (C.max(axis=2, keepdims=True) - C).max(axis=1).ravel()
    sum_over_targets = scipy.sparse.kron(eye(types * strategies), ones((1, targets)))
    sum_over_strategies = scipy.sparse.kron(
        eye(types), scipy.sparse.kron(ones((1, strategies)), eye(targets))
    )
    short = [-C_of_x, a_of_type, None]
    rows = [
        [scipy.sparse.csr_array(ones((1, strategies))), None, None, None],
        [-scipy.sparse.kron(ones((types, 1)), eye(strategies)), None, sum_over_targets, None],
        [None, None, sum_over_strategies, -eye(types * targets)],
        [*short, None],
        [*short, scipy.sparse.diags_array(most)],
    ]
    products, answers = types * strategies, types * targets
    lower = np.concatenate([ones(1), np.zeros(products + 2 * answers), np.full(answers, -np.inf)])
    upper = np.concatenate([ones(1), np.zeros(products + answers), np.full(answers, np.inf), most])
    sizes = [strategies, types, R.size, answers]
    objective = np.concatenate([np.zeros(strategies + types), -R.ravel(), np.zeros(answers)])
    integrality = np.repeat([0, 0, 0, 1], sizes)
    constraints = scipy.optimize.LinearConstraint(
        scipy.sparse.block_array(rows, format="csr"), lower, upper
    )
    # HiGHS can fail after presolving payoffs that nearly tie; it then solves without presolving.
    for presolve in (True, False):
        with no_output():
            program = scipy.optimize.milp(
                objective,
                integrality=integrality,
                bounds=scipy.optimize.Bounds(0, 1),
                constraints=constraints,
                options={"mip_rel_gap": 0, "presolve": presolve, "time_limit": time_limit},
            )
        if program.x is not None:
            break
        if program.status == 1:
            raise RuntimeError(
                f"stackelberg: HiGHS found no commitment of {types} types in {time_limit:g} s; "
                "expected fewer types or targets, or a longer time_limit"
            )
    else:
        raise RuntimeError(f"stackelberg: HiGHS found no solution: {program.message}")
    x, _, _, q = np.split(program.x, np.cumsum(sizes)[:-1])
    answer = q.reshape(types, targets).argmax(axis=1)
    # The linear program of these answers is more accurate than the mixed-integer program. It has no
    # solution if the answers are best only within the tolerance of the mixed-integer program.
    polished = _commit(R, C, answer)
    weights = _on_simplex(x) if polished is None else polished[0]
    return weights, answer, -program.mip_dual_bound, int(program.mip_node_count)


def _multiple_lp(R: _Payoffs, C: _Payoffs) -> _Solved:
    types, _, targets = C.shape
    profiles = targets**types
    if profiles > _MAX_PROFILES:
        raise ValueError(
            f"method: {types} types and {targets} targets have {profiles} combinations of answers; "
            f"expected at most {_MAX_PROFILES} for 'multiple-lp', or 'dobss'"
        )
    answers = map(np.array, itertools.product(range(targets), repeat=types))
    solved = [(found, answer) for answer in answers if (found := _commit(R, C, answer))]
    if not solved:
        raise RuntimeError("stackelberg: HiGHS found no commitment with any answer")
    (weights, _, _), answer = max(solved, key=lambda commitment: commitment[0][1])
    return weights, answer, max(bound for (_, _, bound), _ in solved), profiles


def _commit(
    R: _Payoffs, C: _Payoffs, answer: Int[np.ndarray, "types"]
) -> tuple[_Weights, float, float] | None:
    """Find the best weights for which `answer` are the best answers of the types, or `None`.

    **Returns:** the weights, their value, and an upper bound on the value of all such weights.
    """
    each = np.arange(len(C))
    paid = R[each, :, answer].sum(axis=0)
    # The gain of each type from each target, relative to the given answer.
    gain = (C - C[each, :, answer][..., None]).transpose(0, 2, 1).reshape(-1, C.shape[1])
    # HiGHS can fail if payoffs nearly tie; its default tolerances then suffice.
    for options in (_LP_OPTIONS, {}):
        program = scipy.optimize.linprog(
            -paid,
            A_ub=gain,
            b_ub=np.zeros(len(gain)),
            A_eq=np.ones((1, gain.shape[1])),
            b_eq=[1.0],
            method="highs",
            options=options,
        )
        if program.status == 0:
            break
        if program.status == 2:
            return None
    else:
        raise RuntimeError(f"stackelberg: HiGHS found no solution: {program.message}")
    weights = _on_simplex(program.x)
    # Any nonnegative prices of the constraints give a bound.
    price = np.maximum(0.0, -program.ineqlin.marginals)
    return weights, float(weights @ paid), float((paid - price @ gain).max())


def _on_simplex(weights: _Weights) -> _Weights:
    """Make weights from a solver nonnegative with sum 1, because rounding may have changed them."""
    positive = np.maximum(0.0, weights)
    return positive / positive.sum()


def _unit(payoffs: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Scale nonnegative numbers so that the largest number is 1, unless all are 0."""
    most = payoffs.max()
    return payoffs / most if most > 0 else payoffs


def _payoffs(name: str, values: Any) -> _Payoffs:
    array = finite(name, values)
    if array.ndim not in (2, 3) or array.size == 0:
        raise ValueError(
            f"{name}: expected [strategies, targets] or [types, strategies, targets], got the "
            f"shape {list(array.shape)}"
        )
    return array.reshape(-1, *array.shape[-2:])
