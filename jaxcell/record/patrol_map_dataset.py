from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from ..patrol import Policy
from .chain_checks import patrol_map_checks
from .checks import with_checks
from .map_patrol import MapPatrol
from .provenance import provenance


_PROBABILITY = {"units": "1"}


def patrol_map_dataset(patrol: MapPatrol, *, spec: Mapping[str, Any] | None = None) -> xr.Dataset:
    """The patrol of a map, and how vulnerable it is, as a labelled dataset.

    Over `position` and `other`: `visible`. Over `robot` and `position`: `stop`, the place of a cell
    in the cover of the robot, and its walk, `image` and `probability`, over `branch` too; the chain
    of a robot with fewer branches than another ends with branches of probability 0. Over `edge`:
    its two `end`s, and with `robot` its `weight`. Over `robot`: `commute_time`, and the `contact`
    cell.

    Over `attack_time` and `position`: `capture`, for every cell that an adversary may attack. Of
    the cell that is the target: `view` and `boundary` over `position`; `exact`, `simulated` and
    `fitted` over `attack_time`; the exact `law` over `step`, and the simulated `arrival` over
    `run`, inf where it was given up; and `gld`, the parameters of the fit.

    If there is a base station: `region` and `base_view` over `position`. If a robot is lost:
    `region_after` and, over `robot_after`, who takes a region and `weight_after`. If there is a
    game: over `share` the `mixture`, and with `position`, `share_capture`.

    `dataset.capture.set_index(position=("y", "x")).unstack()` is the vulnerability map.

    **Arguments:**

    - `patrol`: the patrol.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if `spec` is not JSON; `RuntimeError` if the result contradicts itself.

    One robot in a corridor of four cells, each of which sees its neighbours:

        >>> import jax
        >>> from jaxcell import patrol, record, space
        >>> room = space.Workspace([(0, 0), (4, 0), (4, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 1)
        >>> graph, visible = patrol.cell_graph(cells), space.visible_cells(cells, 1.6)
        >>> policies = patrol.distributed_policies(graph, visible, 1)
        >>> problem = graph, visible, policies
        >>> attack = patrol.vulnerability(jax.random.key(0), *problem, 0, [2], runs=5)
        >>> capture = patrol.capture_probabilities(*problem, [2])
        >>> found = record.MapPatrol(cells, 1.6, *problem, attack, capture)
        >>> dataset = record.patrol_map_dataset(found)
        >>> dict(dataset.capture.sizes), dataset.exact.values.round(3).tolist()
        ({'attack_time': 1, 'position': 4}, [0.889])
    """
    x, y = patrol.xy.T
    metres = {"units": "m", "long_name": "centre of the cell"}
    dataset = xr.Dataset(
        {**_policies(patrol), **_attack(patrol), **_regions(patrol), **_game(patrol)},
        coords={
            "attack_time": ("attack_time", patrol.attack.attack_times, {"units": "steps"}),
            "x": ("position", x, metres),
            "y": ("position", y, metres),
        },
        attrs={
            **provenance("Patrol of a map with limited visibility", None, spec),
            "source": "jaxcell; after Alam 2018, sections 4.4.3 to 4.4.6",
            "cell_side_m": patrol.cells.cell,
            "range_m": patrol.reach,
            "target": patrol.attack.target,
        },
    )
    if patrol.game is not None:
        dataset = dataset.assign_coords(share=("share", patrol.game.shares))
    return with_checks(dataset, patrol_map_checks(dataset))


def _policies(patrol: MapPatrol) -> dict[str, tuple[Any, ...]]:
    policies, positions = patrol.policies, patrol.cells.positions
    stop = np.full((len(policies), positions), -1, np.int32)
    branches = max(len(policy.chain.image) for policy in policies)
    image = np.tile(np.arange(positions, dtype=np.int32), (len(policies), branches, 1))
    probability = np.zeros(image.shape)
    for robot, policy in enumerate(policies):
        stop[robot, policy.cover] = np.arange(policy.cover.size)
        image[robot, : len(policy.chain.image)] = policy.chain.image
        probability[robot, : len(policy.chain.image)] = policy.chain.probability
    walk = ("robot", "branch", "position")
    whole = {"long_name": "whether other is wholly seen from the centre of position"}
    variables: dict[str, tuple[Any, ...]] = {
        "visible": (("position", "other"), patrol.visible, whole),
        "stop": (
            ("robot", "position"),
            stop,
            {"long_name": "place in the cover, from 0", "padding": "-1: not in the cover"},
        ),
        "image": (walk, image, {"long_name": "cell that a step may lead to"}),
        "probability": (walk, probability, _PROBABILITY),
        "end": (("edge", "side"), patrol.graph.edges, {"long_name": "a cell"}),
        "weight": (("robot", "edge"), _weights(policies), _PROBABILITY),
        "commute_time": (
            "robot",
            np.array([policy.commute_time for policy in policies]),
            {"long_name": "expected, mean over pairs of cells", "units": "steps"},
        ),
    }
    if patrol.regions is not None:
        contact = np.array([policy.contact for policy in policies], np.int32)
        variables["contact"] = ("robot", contact, {"long_name": "cell where the robot reports"})
    return variables


def _attack(patrol: MapPatrol) -> dict[str, tuple[Any, ...]]:
    attack, fit = patrol.attack, patrol.attack.fit
    caught = {"long_name": "probability of capture", **_PROBABILITY}
    law = {"long_name": "probability that the first robot is in view then", **_PROBABILITY}
    variables: dict[str, tuple[Any, ...]] = {
        "capture": (("attack_time", "position"), patrol.capture, caught),
        "view": ("position", attack.view, {"long_name": "whether the target is seen"}),
        "boundary": ("position", attack.boundary, {"long_name": "where a robot first sees it"}),
        "exact": ("attack_time", attack.exact, caught),
        "simulated": ("attack_time", attack.simulated, caught),
        "fitted": ("attack_time", attack.fitted, caught),
        "law": ("step", attack.law, law),
        "arrival": ("run", np.asarray(attack.arrivals.time), {"units": "steps"}),
    }
    if fit is not None:
        parameters = np.array([fit.law.l1, fit.law.l2, fit.law.l3, fit.law.l4], float)
        about = {"log_likelihood": fit.log_likelihood, "distance": fit.distance}
        meaning = {"long_name": "FMKL generalized lambda distribution: l1, l2, l3, l4"}
        variables["gld"] = ("parameter", parameters, {**meaning, **about})
    return variables


def _regions(patrol: MapPatrol) -> dict[str, tuple[Any, ...]]:
    if patrol.regions is None:
        return {}
    nobody = {"long_name": "region of the cell", "padding": "-1: nobody patrols"}
    variables: dict[str, tuple[Any, ...]] = {
        "base": ((), patrol.regions.base, {"long_name": "cell of the base station"}),
        "base_view": ("position", patrol.regions.view),
        "region": ("position", patrol.regions.region, nobody),
    }
    after = patrol.reassignment
    if after is not None:
        which = {"long_name": "robot that takes the region"}
        late = {"long_name": "steps without a report", "units": "steps"}
        variables |= {
            "region_after": ("position", after.regions.region, nobody),
            "robot_after": ("region", after.robot, which),
            "weight_after": (("region", "edge"), _weights(after.policies), _PROBABILITY),
            "silence_limit": ((), after.after, late),
        }
    return variables


def _game(patrol: MapPatrol) -> dict[str, tuple[Any, ...]]:
    if patrol.game is None:
        return {}
    game = patrol.game
    caught = {"long_name": "probability of capture", **_PROBABILITY}
    return {
        "mixture": ("share", np.asarray(game.commitment.weights), _PROBABILITY),
        "share_capture": (("share", "position"), game.capture, caught),
        "value": ((), game.commitment.value, caught),
        "attacked": ((), game.attacked, {"long_name": "cell that the adversary chooses"}),
    }


def _weights(policies: Sequence[Policy]) -> np.ndarray:
    return np.stack([policy.weights for policy in policies])
