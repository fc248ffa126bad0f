"""A robot of your own: one that leaves each wall at a random angle.

    python experiments/your_own_robot.py --map data/maps/complex.json

To add a robot, say where each cell leads. `bounce.bounce_map` has what the walls decide: where a
step goes, and where it bumps. Everything else (persistent groups, where the robot is in the long
run, how soon it comes to a place) then works for it as for any other chain.

Writes `your_own_robot.nc`.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray as xr

from jaxcell import bounce, space
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.markov import hitting_times, limiting_distribution
from jaxcell.runtime import configure_jax


def random_bounce_map(cells: space.CellSpace) -> Chain:
    """The generalized map of a robot that turns to any direction, all equally likely, at a bump."""
    straight = bounce.bounce_map(cells, 0.0)
    here = np.arange(cells.size)
    position = here % cells.positions
    direction = np.arange(cells.directions)[:, None]
    turned = direction * cells.positions + position
    # A step has one image, so only the first of its slots is used; the others stay in the cell.
    bumped, first = np.asarray(straight.bumped), direction == 0
    ahead = np.where(first, straight.image, here)
    return Chain(
        np.where(bumped, turned, ahead),
        np.where(bumped, 1 / cells.directions, np.where(first, 1.0, 0.0)),
    )


def study(cells: space.CellSpace, goal: int) -> xr.Dataset:
    """The share of time in each position, and the mean steps from it to the position `goal`."""
    chain = random_bounce_map(cells)
    limiting = limiting_distribution(chain, persistent_groups(chain))
    at_goal = np.arange(cells.size) % cells.positions == goal
    steps = hitting_times(chain, at_goal).value
    by_direction = (cells.directions, cells.positions)
    share = np.asarray(limiting.value).reshape(by_direction).sum(axis=0)
    mean = np.asarray(steps).reshape(by_direction).mean(axis=0)
    x, y, _ = cells.centre(np.arange(cells.positions))
    return xr.Dataset(
        {"share": ("position", share), "steps_to_goal": ("position", mean)},
        coords={"x": ("position", x, {"units": "m"}), "y": ("position", y, {"units": "m"})},
        attrs={"goal": goal, "residual": float(limiting.certificate.residual)},
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--map", type=Path, default=Path("data/maps/complex.json"))
    parser.add_argument("--directions", type=int, default=16)
    parser.add_argument("--goal", type=int, default=0, help="a position")
    parser.add_argument("--out", type=Path, default=Path("runs/your_own_robot"))
    options = parser.parse_args()
    configure_jax()
    cells = space.CellSpace.load(options.map, directions=options.directions)
    found = study(cells, options.goal)
    options.out.mkdir(parents=True, exist_ok=True)
    found.to_netcdf(options.out / "your_own_robot.nc")
    print(f"{cells.positions} positions; an even share of time would be {1 / cells.positions:.5f}")
    print(f"least share {found.share.min().item():.5f}, most {found.share.max().item():.5f}")
    print(f"mean steps to position {options.goal}: {found.steps_to_goal.mean().item():.1f}")


if __name__ == "__main__":
    main()
