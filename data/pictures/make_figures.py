"""Make the figures of README, `localized.png`, and of the page on concepts, `maps.png`.

python data/pictures/make_figures.py [FOLDER]
"""

import math
import sys
from pathlib import Path

import jax
import matplotlib
import numpy as np
from PIL import Image


jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402

from jaxcell import bounce, bundled, space  # noqa: E402


HERE = Path(__file__).parent
BOUNCE, ERROR, RELIABILITY = 135, 45, 0.8
# The number of the direction whose cells are drawn.
DIRECTION = 1
STEP, BUMP, OTHER = "#0072b2", "#d55e00", "#bbbbbb"
# The cell where the robot of README starts, and the observations after which it is drawn.
START, AFTER = 129, (0, 2, 7, 11)


def main(folder: Path) -> None:
    """Write the figures."""
    cells = space.CellSpace.load(bundled("lab_a"))
    draw_localized(cells).savefig(folder / "localized.png", dpi=100)
    draw_maps(cells).savefig(folder / "maps.png", dpi=100)
    for name in ("localized.png", "maps.png"):
        # A palette without transparency needs a third of the bytes.
        Image.open(folder / name).convert("RGB").quantize(64).save(folder / name)


def draw_localized(cells: space.CellSpace) -> plt.Figure:
    """Draw a robot, and the cells where it can be, after some of its observations."""
    simple = bounce.bounce_map(cells, math.radians(BOUNCE))
    image, bumped = np.asarray(simple.image), np.asarray(simple.bumped)
    figure, axes = plt.subplots(2, 2, figsize=(8, 4.8), layout="constrained")
    robot, possible, seen = START, np.arange(cells.size), 0
    for ax, after in zip(axes.flat, AFTER, strict=True):
        for _ in range(after - seen):
            possible = np.unique(image[possible[bumped[possible] == bumped[robot]]])
            robot = image[robot]
        seen = after
        draw_room(ax, cells)
        ax.set(xlabel="", ylabel="")
        ax.set_title(f"cells possible after {after} observations: {possible.size}")
        for cell in possible:
            x, y, _ = cells.centre(int(cell))
            ray(ax, x, y, cell // cells.positions, cells, STEP, width=2)
        ax.plot(*cells.centre(int(robot))[:2], "o", color=BUMP, markersize=7)
    return figure


def draw_maps(cells: space.CellSpace) -> plt.Figure:
    """Draw cells, their images, and their images if turns are imprecise."""
    angle = math.radians(BOUNCE)
    simple = bounce.bounce_map(cells, angle)
    chain = bounce.noisy_bounce_map(cells, angle, math.radians(ERROR), RELIABILITY)
    figure, axes = plt.subplots(3, 1, figsize=(7, 10.5), layout="constrained")
    titles = (
        f"Cells: {cells.positions} positions, each with {cells.directions} directions",
        f"A simple map: one image each (heading 45° here; a bump turns by {BOUNCE}°)",
        f"A generalized map: a turn is right with probability {RELIABILITY:g}",
    )
    for ax, title in zip(axes, titles, strict=True):
        draw_room(ax, cells)
        ax.set_title(title)
    for position in range(cells.positions):
        x, y, _ = cells.centre(position)
        axes[0].text(x, y, str(position), ha="center", va="center")
        for direction in range(cells.directions):
            ray(axes[0], x, y, direction, cells, OTHER, inner=0.25)
        cell = DIRECTION * cells.positions + position
        images = {simple.image[cell].item(): 1.0}
        draw_images(axes[1], cells, cell, images, bool(simple.bumped[cell]))
        many = zip(chain.image[:, cell].tolist(), chain.probability[:, cell].tolist(), strict=True)
        images = {image: probability for image, probability in many if probability > 0}
        draw_images(axes[2], cells, cell, images, bool(simple.bumped[cell]))
    return figure


def draw_room(ax: plt.Axes, cells: space.CellSpace) -> None:
    """Draw the squares of a map, with dark walls."""
    rows, columns = cells.free.shape
    ax.imshow(~cells.free, origin="lower", extent=(0, columns, 0, rows), cmap="Greys", vmin=-0.05)
    ax.set(xticks=range(columns + 1), yticks=range(rows + 1), xlabel="x (m)", ylabel="y (m)")
    ax.grid(color=OTHER, linewidth=0.5)


def draw_images(ax, cells, cell, images, bumped) -> None:
    """Draw the images of a cell: a step to another square, or turns in its own."""
    x, y, _ = (float(part) for part in cells.centre(cell))
    for image, probability in images.items():
        if bumped:
            ray(ax, x, y, image // cells.positions, cells, BUMP, width=0.5 + 2 * probability)
        else:
            to = np.array(cells.centre(image)[:2], float)
            style = {"arrowstyle": "->", "color": STEP, "linewidth": 1.8}
            ax.annotate("", to - 0.12, (x, y), arrowprops=style)
    ax.plot(x, y, ".", color=BUMP if bumped else STEP)


def ray(ax, x, y, direction, cells, color, *, inner=0.0, width=1.0) -> None:
    """Draw a short line from a centre in a direction."""
    angle = 2 * math.pi * direction / cells.directions
    ends = [(x + r * math.cos(angle), y + r * math.sin(angle)) for r in (inner, 0.42)]
    ax.plot(*zip(*ends, strict=True), color=color, linewidth=width)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
