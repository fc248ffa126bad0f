"""Filters, plans and policies on an iRobot Create 2 or Roomba, over a serial line, without JAX.

**The robot** speaks the *Open Interface*: the host sends commands of a few bytes, and every 15 ms
the robot sends a *frame* of sensor *packets*. It has four *modes* (`Mode`). In Off and Passive it
does not drive. In Safe the host drives it, and a cliff, a dropped wheel or a charger switches it
back to Passive. In Full it ignores them, so this package never uses Full. Lengths are in metres,
angles in radians counter-clockwise, times in seconds.

**Safety.** The Open Interface has no timeout: the wheels keep their last speed until the next
command. Therefore a `Driver`, such as `Create`, stops them when its `with` block ends, when the
robot is in danger, when the robot or the caller is silent, and when the driving process hangs or is
killed. It cannot stop a robot whose cable is pulled out, or whose computer loses power. On a
damaged line, `StreamParser` accepts no wrong values as long as at most one byte in three
consecutive frames is changed, lost or doubled.

**Steps.** A `Walker` drives the steps of the model of bouncing robots (Alam 2018, Eq. 2.4) from
cell to cell, and measures them with the encoders of the wheels; `cell_strides` computes the
displacement of a step in each direction. A step ends at the centre of a cell, or where it began if
a bumper was pressed. The robot observes 0 for a step and 1 for a bump, as a filter expects.

| task (read by `load_task`) | run | replay of a log | Alam 2018 |
| --- | --- | --- | --- |
| `FilterFollower`: a localization filter | `run_follower` | `replay_follower` | section 2.4 |
| `PolicyFollower`: a localization policy | `run_follower` | `replay_follower` | chapter 2 |
| `BeliefFollower`: a belief of a robot that slips | `run_follower` | `replay_follower` | |
| `AnywhereSettings`: an unknown pose | `run_anywhere` | `replay_anywhere` | section 2.3.1 |
| a plan | `run_plan` | `plan_outcome` | section 3.4.1 |
| a robot of a team: `member_actions`, `save_team` | `run_member` | | Alg. 3.4 |
| a patrol: `save_patrols`, `Patrol` | `run_patrol` | `replay_patrol` | section 4.5.7 |

Each run returns a `RunOutcome`. A `RunLog` writes every observation to the disk before the robot
continues. `read_log` reads the log, even if it was cut off, and a replay has the same outcome.

A stopped run can be resumed. A `Walker` that is given the earlier observations replays their steps
without driving, so that the task returns to its last state. `Calibrated` corrects the encoders of a
robot with the `Calibration` that `jaxcell robot calibrate` measures, and saves in the
`calibration_file`.

**Patrols** go from cell to cell with Lee's wave routing. `grid_steps` lists the neighbours of each
square of a grid, and `wave` counts the steps to a goal, in time proportional to the number of
cells. A patrol may look for a dummy intruder, a dark cross on a light sheet. `draw_cross` draws the
sheet, and `CrossLook` searches for it with `find_cross` in frames from a `camera` or from
`pictures`. They need OpenCV (`pip install 'jaxcell[vision]'`).

**Slip** is not sensed by the encoders. `Particles` estimate the place of a slipping robot, and have
the same methods `start`, `observe` and `estimate` as `Belief` of `jaxcell.automata`.

**On ROS 2**, `jaxcell.robot.ros` drives an iRobot Create 3 or TurtleBot 4, or any base with
`cmd_vel` and `odom`, and publishes the possible places of the robot. It must be imported
separately because it needs `rclpy`. It has not been tested on a robot.

**Without a host**, an Arduino on the robot's serial line runs a filter or a policy with the program
that `filter_sketch` or `policy_sketch` writes, or bounces forever with the program of
`bounce_sketch` (section 3.5.4).

**Without hardware**, `jaxcell.robot.emulation.emulator` is a robot at the other end of a serial
line, `jaxcell.robot.emulation.simulated` runs the driver and this robot on one clock, and
`jaxcell.robot.physics` moves the body of the robot with a physics engine.
"""

import types

from ..base import optional_modules


if not optional_modules.has_module("serial"):
    raise optional_modules.missing_module("serial")

from .anywhere import (
    AnywhereOutcome as AnywhereOutcome,
    AnywhereSettings as AnywhereSettings,
    replay_anywhere as replay_anywhere,
    run_anywhere as run_anywhere,
)
from .calibration import (
    Calibrated as Calibrated,
    Calibration as Calibration,
    calibration_file as calibration_file,
)
from .create.clock import ByClock as ByClock
from .create.driver import Driver as Driver, Port as Port, RobotStopped as RobotStopped
from .create.motion import Create as Create, Moved as Moved
from .create.open_interface import (
    Command as Command,
    CommandParser as CommandParser,
    StreamParser as StreamParser,
)
from .create.packets import Contact as Contact, Mode as Mode, Packet as Packet
from .create.reading import STREAM as STREAM, Reading as Reading
from .followers import (
    BeliefFollower as BeliefFollower,
    FilterFollower as FilterFollower,
    PolicyFollower as PolicyFollower,
    replay_follower as replay_follower,
    run_follower as run_follower,
)
from .frames import camera as camera, pictures as pictures
from .marker import (
    CrossLook as CrossLook,
    Marker as Marker,
    draw_cross as draw_cross,
    find_cross as find_cross,
)
from .outcome import RunOutcome as RunOutcome
from .particles import Cloud as Cloud, Particles as Particles
from .patrol import (
    Patrol as Patrol,
    PatrolOutcome as PatrolOutcome,
    replay_patrol as replay_patrol,
    run_patrol as run_patrol,
)
from .plan import plan_outcome as plan_outcome, run_plan as run_plan
from .routing import grid_steps as grid_steps, wave as wave
from .run_log import LoggedRun as LoggedRun, RunLog as RunLog, read_log as read_log
from .sketch import (
    bounce_sketch as bounce_sketch,
    filter_sketch as filter_sketch,
    policy_sketch as policy_sketch,
)
from .tasks.files import load_task as load_task
from .tasks.patrol_task import PatrolTask as PatrolTask, save_patrols as save_patrols
from .team import (
    MemberTask as MemberTask,
    member_actions as member_actions,
    run_member as run_member,
    save_team as save_team,
)
from .walker import Walker as Walker, cell_strides as cell_strides


def __dir__() -> list[str]:
    return [name for name, value in globals().items() if not isinstance(value, types.ModuleType)]
