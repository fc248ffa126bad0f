import math
import re
import string
import textwrap
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..automata import (
    Filter,
    MooreMachine,
    Policy,
    machine_to_c_header,
    policy_to_c_header,
    to_c_header,
)
from ..automata.filter import CONFIRM
from .create.packets import METRES_PER_COUNT, WHEEL_BASE
from .tasks.files import FilterTask, PolicyTask


FLASH = 32256
"""The flash memory of an Arduino Uno that is free for a program, in bytes."""

PROGRAM_BYTES = 15_000
"""An upper bound on the size of a program without its tables, in bytes. With GCC 5.4 and the
Arduino core 1.8.7, the size is 12 to 14 kB."""

_TEMPLATE = Path(__file__).with_name("sketch.ino.in")

_TABLE = re.compile(r"uint(\d+)_t filter_(\w+)\[(\d+)\](?:\[(\d+)\])? FILTER_TABLE")
# The largest object of an AVR, and the end of the flash that the header can read, in bytes.
_LARGEST_TABLE = 2**15 - 1
_NEAR_FLASH = 2**16


def filter_sketch(
    task: FilterTask,
    *,
    direction: int | None = None,
    flash: int = FLASH,
    machine: MooreMachine | None = None,
    confirm: int = CONFIRM,
) -> str:
    """Write a program for an Arduino that runs a localization filter on a Create, without a host.

    It computes the same colours as a [`jaxcell.robot.FilterFollower`][] with a
    [`jaxcell.robot.Walker`][]. It ends in a knowledge cycle, when `confirm` further observations
    have not refuted the map. The comment at the top of the program explains the wiring, and the
    events that stop the robot.

    **Arguments:**

    - `task`: the filter, with its cells and bouncing angle.
    - `direction`: the number of the robot's direction at the start, or `None` if it is unknown.
        See [`jaxcell.robot.Walker`][].
    - `flash`: the flash memory of the board, in bytes.
    - `machine`: a smaller machine for the program to run instead of the filter or policy, the one
        that [`jaxcell.automata.fewest_bytes`][] finds with its default `output`. It does not detect
        most impossible observations, so its answer is not confirmed.
    - `confirm`: the number of observations that confirm the answer of the filter.

    **Returns:** the text of the program.

    **Raises:** `ValueError` if the tables are too large, if the direction does not exist, or if the
    direction is known and a bouncing angle is not a multiple of the angle between directions.

    The filter of a robot that goes to cell 0 of three cells and stays there:

        >>> import pathlib
        >>> import numpy as np
        >>> from jaxcell import robot
        >>> from jaxcell.automata import Filter, subset_construction
        >>> from jaxcell.robot.tasks.files import FilterTask
        >>> image, bumped = np.int32([0, 0, 1]), np.array([True, False, False])
        >>> filter = Filter.of(subset_construction(image, bumped))
        >>> task = FilterTask(pathlib.Path("filter.jxf"), 1.0, 4, 1.0, 0.0, filter, 0.0)
        >>> print(*robot.filter_sketch(task).splitlines()[:1])
        /* Localizes an iRobot Create 2 by its bumps: a filter of 3 states.
    """
    return _localizing(task, task.filter, direction, flash, machine, confirm)


def policy_sketch(
    task: PolicyTask,
    *,
    direction: int | None = None,
    flash: int = FLASH,
    machine: MooreMachine | None = None,
) -> str:
    """Write a program for an Arduino that runs a localization policy on a Create, without a host.

    It chooses the same angles as a [`jaxcell.robot.PolicyFollower`][] with a
    [`jaxcell.robot.Walker`][]. It ends with the policy, whose answer it does not confirm.

    **Arguments:** the policy, and the options of [`filter_sketch`][], with the same errors.
    **Returns:** the text of the program.

    The policy of a robot that bumps after two steps, and is localized there:

        >>> import pathlib
        >>> import numpy as np
        >>> from jaxcell import robot
        >>> from jaxcell.automata import Policy
        >>> from jaxcell.robot.tasks.files import PolicyTask
        >>> policy = Policy(
        ...     turn=np.int32([-1, -1]), first=np.int32([0, 1, 1]), steps=np.int32([2]),
        ...     target=np.int32([1]), offsets=np.int32([0, 2, 3]), members=np.int32([0, 1, 1]),
        ... )
        >>> task = PolicyTask(pathlib.Path("policy.jxf"), 1.0, 4, 1.0, 0.0, (1.5,), policy)
        >>> print(*robot.policy_sketch(task).splitlines()[:1])
        /* Localizes an iRobot Create 2 by its bumps: a policy of 2 states.
    """
    return _localizing(task, task.policy, direction, flash, machine, 0)


def _localizing(
    task: FilterTask | PolicyTask,
    source: Filter | Policy,
    direction: int | None,
    flash: int,
    machine: MooreMachine | None,
    confirm: int,
) -> str:
    choosing = isinstance(source, Policy)
    if machine is not None:
        confirm, text = 0, _machine_header(source, machine)
    elif isinstance(source, Policy):
        text = policy_to_c_header(source, name="filter")
    else:
        text = to_c_header(source)
    tables = table_bytes(text)
    states = len(source.uncertainty if machine is None else machine.transition)
    angles = ", ".join(f"{math.degrees(bounce):g}" for bounce in task.bounces)
    _check_direction(task, direction)
    strides = None if direction is None else task.strides
    stride_bytes = 0 if strides is None else 8 * len(strides)
    _check_flash(tables, stride_bytes, flash, task.path, states)
    return _fill(
        title=f"Localizes an iRobot Create 2 by its bumps: a {task.kind} of {states} states.",
        source=[
            str(task.path),
            f"cells of {task.cell:g} m, {task.directions} directions, steps of {task.step:g} m, "
            f"bounces by {'one of ' * choosing}{angles} degrees",
        ],
        tables=text,
        table_bytes=sum(tables.values()) + stride_bytes,
        step=task.step,
        bounces=task.bounces,
        choosing=choosing,
        confirm=confirm,
        strides=strides,
        direction=direction or 0,
    )


def bounce_sketch(bounce: float, step: float) -> str:
    """Write a program for an Arduino with which a Create bounces forever, without a filter.

    Several robots can run the program at once. In the coverage experiment of Alam 2018, section
    3.5.4, two robots with an Arduino turn by the same angle when they bump into a wall or each
    other.

    **Arguments:** the bouncing angle in radians, counter-clockwise, and the length of a step in
    metres. After a bump the robot returns to the start of the step. **Returns:** the text of the
    program.

    A robot with steps of half a metre that turns by 90 degrees at each bump:

        >>> import math
        >>> from jaxcell import robot
        >>> print(*robot.bounce_sketch(math.pi / 2, 0.5).splitlines()[:1])
        /* Lets an iRobot Create 2 bounce: it turns by one angle at each bump.
    """
    if not math.isfinite(bounce):
        raise ValueError(f"bounce: expected a finite angle, got {bounce}")
    if not (math.isfinite(step) and step > 0):
        raise ValueError(f"step: expected a positive number, got {step}")
    return _fill(
        title="Lets an iRobot Create 2 bounce: it turns by one angle at each bump.",
        source=[f"steps of {step:g} m, bounces by {math.degrees(bounce):g} degrees"],
        step=step,
        bounces=(bounce,),
    )


_ANSWERS = """
/* The number of possible configurations, by the outputs that end the run. */
static const uint16_t filter_uncertainties[%d] FILTER_TABLE = {%s};

static inline uint16_t filter_uncertainty(filter_state state) {
    return FILTER_READ(16, filter_uncertainties[filter_color(state) - %d]);
}
"""

_TURNS = """
#define FILTER_NO_TURN 255

static inline uint8_t filter_turn(filter_state state) {
    if (filter_refuted(state) || state.steps > 0) return FILTER_NO_TURN;
    return filter_color(state) < %d ? filter_color(state) : FILTER_NO_TURN;
}
"""


def _machine_header(source: Filter | Policy, machine: MooreMachine) -> str:
    whole = MooreMachine.of(source)
    ends = whole.color >= whole.final
    known = dict(zip(whole.color[ends].tolist(), source.uncertainty[ends].tolist(), strict=True))
    answers = [str(known[color]) for color in sorted(known)]
    text = machine_to_c_header(machine)
    text += _ANSWERS % (len(answers), ", ".join(answers), whole.final)
    if isinstance(source, Policy):
        text += _TURNS % (whole.final - 1)
    return text


def table_bytes(header: str) -> dict[str, int]:
    """Map the name of each table in a C header to the size of the table in bytes."""
    return {
        name: int(bits) // 8 * int(rows) * int(columns or 1)
        for bits, name, rows, columns in _TABLE.findall(header)
    }


def _check_direction(task: FilterTask | PolicyTask, direction: int | None) -> None:
    """Raise `ValueError` if the direction does not exist, or a bounce ends between directions."""
    if direction is None:
        return
    if not 0 <= direction < task.directions:
        raise ValueError(f"direction: expected 0 to {task.directions - 1}, got {direction}")
    for bounce in task.bounces:
        turn = bounce * task.directions / (2 * math.pi)
        if abs(turn - round(turn)) > 1e-6:
            raise ValueError(
                f"{task.path}: bounce_deg: {math.degrees(bounce):g} deg is not a whole number of "
                f"the {task.directions} directions"
            )


def _check_flash(tables: dict[str, int], strides: int, flash: int, path: Path, states: int) -> None:
    sizes = ", ".join(f"{size:,} for {name}" for name, size in tables.items())
    sizes = f"{states:,} states take {sizes}"
    name, largest = max(tables.items(), key=lambda item: item[1])
    if largest > _LARGEST_TABLE:
        raise ValueError(
            f"{path}: the table {name} has {largest:,} bytes; an AVR allows for "
            f"{_LARGEST_TABLE:,} ({sizes})"
        )
    total = sum(tables.values()) + strides
    room = min(flash - PROGRAM_BYTES, _NEAR_FLASH - 1024)
    if total > room:
        raise ValueError(
            f"{path}: the tables have {total:,} bytes; there is room for {max(room, 0):,}, in "
            f"{flash:,} bytes of flash with a program of up to {PROGRAM_BYTES:,}, and within the "
            f"first 64 KiB ({sizes})"
        )


def _fill(
    *,
    title: str,
    source: list[str],
    step: float,
    bounces: tuple[float, ...],
    tables: str | None = None,
    table_bytes: int = 0,
    strides: Float[np.ndarray, "directions 2"] | None = None,
    direction: int = 0,
    choosing: bool = False,
    confirm: int = 0,
) -> str:
    placing = (
        "Put the robot in the middle of a cell, along one of the directions. Its heading is not "
        "known, so that all steps have one length."
        if strides is None
        else "Put the robot in the middle of a cell, facing "
        f"{360 * direction / len(strides):g} degrees counter-clockwise from the x axis of the map."
    )
    ending = ""
    if confirm:
        ending = (
            f"The run ends when the robot is localized and {confirm} further observations have not "
            "refuted the map. "
        )
    elif tables is not None:
        ending = (
            "The run ends as soon as the robot is localized. No further observation confirms the "
            "answer, and on another map many robots are localized, too. "
        )
    rows = [] if strides is None else strides.tolist()
    return string.Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=title,
        source="\n".join(f" *     {_comment(line)}" for line in source),
        placing="\n * ".join(textwrap.wrap(ending + placing, 96)),
        says="" if tables is None else ", and the colour after it",
        lights="it blinks slowly if the robot was stopped; the USB port prints the reason"
        if tables is None
        else "on: localized; fast: refuted; slow: stopped for the reason that the USB port prints",
        table_bytes=f"{table_bytes:,}",
        program_bytes=f"{PROGRAM_BYTES:,}",
        filtered=int(tables is not None),
        tables=tables or "",
        directions=len(rows),
        strides="\n".join(f"    {{{_float(ahead)}, {_float(left)}}}," for ahead, left in rows),
        start_direction=direction,
        step=_float(step),
        choosing=int(choosing),
        confirm=confirm,
        # Each turn takes the shorter way.
        bounces=", ".join(_float(math.remainder(bounce, 2 * math.pi)) for bounce in bounces),
        metres_per_count=_float(METRES_PER_COUNT),
        wheel_base=_float(WHEEL_BASE),
    )


def _float(value: float) -> str:
    """Write a number as a `float` literal of C, because an AVR has no doubles."""
    return f"{float(value)!r}f"


def _comment(text: str) -> str:
    """Escape the comment delimiters of C in a text, and replace unprintable characters."""
    printable = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return printable.replace("*/", "* /").replace("/*", "/ *")
