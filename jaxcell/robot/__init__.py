"""Filters, plans and policies on an iRobot Create 2 or Roomba, over a serial line. Imports no JAX.

The robot speaks the *Open Interface*: commands of a few bytes from the host, and every 15 ms a
*frame* of sensor *packets* from the robot. It has four *modes*: Off; Passive, in which it only
senses; Safe, in which the host drives it, and a cliff, a dropped wheel or a charger takes it back
to Passive; and Full, in which nothing does. This package never uses Full.

The Open Interface has no timeout: the wheels keep their last speed until told otherwise. So a
`Create` watches its own caller, and a process of its own watches the process that drives.

A `Walker` makes steps from cell to cell, `run_filter` and `run_plan` use them, and the log of a
run can be replayed. `jaxcell.robot.emulator` has a robot without hardware.
"""

from .clock import ByClock as ByClock
from .create import Create as Create, Moved as Moved
from .driver import Port as Port, RobotStopped as RobotStopped
from .marker import (
    CrossLook as CrossLook,
    Marker as Marker,
    camera as camera,
    draw_cross as draw_cross,
    find_cross as find_cross,
    pictures as pictures,
)
from .open_interface import (
    Command as Command,
    CommandParser as CommandParser,
    StreamParser as StreamParser,
)
from .outcome import Outcome as Outcome
from .packets import Contact as Contact, Mode as Mode, Packet as Packet
from .patrol import (
    Patrol as Patrol,
    PatrolOutcome as PatrolOutcome,
    replay_patrol as replay_patrol,
    run_patrol as run_patrol,
)
from .patrol_task import PatrolTask as PatrolTask, save_patrols as save_patrols
from .reading import STREAM as STREAM, Reading as Reading
from .routing import grid_steps as grid_steps, route as route, wave as wave
from .run_log import LoggedRun as LoggedRun, RunLog as RunLog, read_log as read_log
from .runner import (
    plan_outcome as plan_outcome,
    replay as replay,
    run_filter as run_filter,
    run_plan as run_plan,
)
from .sketch import bounce_sketch as bounce_sketch, filter_sketch as filter_sketch
from .tasks import load_task as load_task
from .team import (
    MemberTask as MemberTask,
    member_actions as member_actions,
    run_member as run_member,
    save_team as save_team,
)
from .walker import Walker as Walker, cell_strides as cell_strides
