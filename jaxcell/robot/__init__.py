"""Filters, plans and policies on an iRobot Create 2 or Roomba, over a serial line. Imports no JAX.

**The robot** speaks the *Open Interface*: commands of a few bytes from the host, and every 15 ms a
*frame* of sensor *packets* from the robot. It has four *modes* (`Mode`): Off; Passive, in which it
only senses; Safe, in which the host drives it, and a cliff, a dropped wheel or a charger takes it
back to Passive; and Full, in which nothing does. This package never uses Full. Lengths are in
metres, angles in radians counter-clockwise, times in seconds.

**What is guaranteed.** The Open Interface has no timeout: the wheels keep their last speed until
the next command. So a `Driver`, as `Create` is one, stops them when its `with` block ends, when
the robot is in danger or silent, when the caller does not renew its speeds, and when the driving
process hangs or is killed. A cable pulled out, or a computer without power, is beyond that. Of a
damaged line, `StreamParser` lets no wrong values through if of three frames in a row one byte is
changed, lost or doubled.

**Steps.** A `Walker` makes the steps of the model of bouncing robots (Alam 2018, Eq. 2.4) from cell
to cell, by the encoders of the wheels, with the strides of `cell_strides`: each ends at the centre
of a cell, or where it began if a bumper was pressed. So what it observes, 0 for a step and 1 for a
bump, is what a filter expects.

| what runs (`load_task` reads it) | run | from a log | source |
| --- | --- | --- | --- |
| `FilterFollower`: a localization filter | `run_follower` | `replay_follower` | section 2.4 |
| `PolicyFollower`: a localization policy | `run_follower` | `replay_follower` | chapter 2 |
| `BeliefFollower`: a belief, if it slips | `run_follower` | `replay_follower` | |
| sets on walls, from anywhere | `run_anywhere` | `replay_anywhere` | section 2.3.1 |
| a plan | `run_plan` | `plan_outcome` | section 3.4.1 |
| a robot of a team: `member_actions`, `save_team` | `run_member` | | Alg. 3.4 |
| a patrol: `save_patrols`, `Patrol` | `run_patrol` | `replay_patrol` | section 4.5.7 |

Each gives an `RunOutcome`. A `RunLog` has every observation on the disk before the robot goes on;
`read_log` reads it, also if it was cut off, and a replay comes to the same outcome.

A run that was stopped goes on: a `Walker` that is given what its robot sensed before takes those
steps as made, and what runs comes to the state where it was. Where the wheels are not those of the
book, `Calibrated` goes by a `Calibration`, which `jaxcell robot calibrate` measures and keeps in
`calibration_file`.

**On the way.** Patrols go from cell to cell by Lee's wave routing: `grid_steps` has the ways of a
grid, `wave` the number of steps to a goal, `route` a shortest way, in time proportional to the
cells. They may look for a dummy intruder, a dark cross on a light sheet: `draw_cross` makes the
sheet, `find_cross` finds it in a frame, and `camera` and `pictures` are sources of frames for
`CrossLook` (these need OpenCV, `pip install 'jaxcell[vision]'`).

**If the robot slips** unseen by its encoders, `Particles` are an estimator beside the belief and
the sets of `jaxcell.automata`: each has `start`, `observe` and `estimate`.

**On ROS 2**, `jaxcell.robot.ros` has an iRobot Create 3 or TurtleBot 4, and any base with `cmd_vel`
and `odom`, as what a `Walker` drives, and publishes where the robot may be. It is imported when it
is asked for, as it needs `rclpy`, and it has met no robot.

**Without a host**, an Arduino on the robot's serial line runs a filter or a policy by the
program that `filter_sketch` or `policy_sketch` writes, or bounces forever by that of
`bounce_sketch` (section 3.5.4).

`jaxcell.robot.emulation.emulator` has a robot at the other end of a serial line without hardware,
`jaxcell.robot.emulation.simulated` the driver and that robot on one clock, and
`jaxcell.robot.physics` the body of a Create 2 that a physics engine moves, for either.
"""

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
from .routing import grid_steps as grid_steps, route as route, wave as wave
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
