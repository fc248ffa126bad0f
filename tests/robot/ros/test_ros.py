"""Robots on ROS 2, with a substitute for rclpy and the messages, and without a real robot."""

import json
import math
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import ros_stub
from robot_files import LAB, SPEC, save_filter
from ros_stub import BACKUP_LIMIT, CLIFF, World
from waiting import wait_until, when
from wheels import MAPS, pose_of

from jaxcell.cli import main
from jaxcell.robot import RobotStopped
from jaxcell.robot.create.watchdog import Watchdog
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.ros import Base, Candidates, Create3, node
from jaxcell.robot.tasks.files import load_task
from jaxcell.robot.tasks.patrol_task import save_patrols
from jaxcell.space import Workspace


HALL = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
KINDS = {"create3": Create3, "base": Base}


def plane(pose):
    """The x, y and heading of a message."""
    heading = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    return pose.position.x, pose.position.y, heading


class Beats(Watchdog):
    """A watchdog without a process."""

    def __init__(self, command):
        self.command, self.beaten, self.dismissed = command, 0, False
        Beats.last = self

    def beat(self):
        self.beaten += 1

    def dismiss(self):
        self.dismissed = True


def await_ticks(world):
    """Wait until the simulated robot has sent several messages."""
    end = world.now + 5 * ros_stub.TICK
    wait_until(lambda: world.now > end)


@pytest.fixture
def world_of(monkeypatch):
    monkeypatch.setattr(node, "Watchdog", Beats)
    modules = dict(sys.modules)

    def make(pose, kind, workspace=HALL):
        world = World(Body(workspace, pose), kind=kind)
        added = {}
        ros_stub.install(world, added)
        for name, module in added.items():
            monkeypatch.setitem(sys.modules, name, module)
        return world

    yield make
    assert modules.keys() <= sys.modules.keys()


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def world(world_of, kind):
    return world_of((1.0, 1.5, 0.0), kind)


def test_a_robot_goes_as_far_as_commanded(world, kind):
    with KINDS[kind](remap=["__ns:=/one"]) as robot:
        with pytest.raises(RobotStopped, match="it is not armed"):
            robot.forward(0.5, tolerance=0.004)
        robot.arm()
        moved = robot.forward(0.5, tolerance=0.004)
        assert moved == pytest.approx((0.5, 0, False, 0), abs=0.01)
        assert robot.turn(-3.5, tolerance=0.01).angle == pytest.approx(-3.5, abs=0.02)
        assert robot.turn(3.5, tolerance=0.01).angle == pytest.approx(3.5, abs=0.02)
        assert robot.forward(-0.3, tolerance=0.004).distance == pytest.approx(-0.3, abs=0.01)
        assert world.body.pose == pytest.approx((1.2, 1.5, 0.0), abs=0.03)
        moved = robot.forward(9.0, tolerance=0.004)
        assert moved.bumped
        assert moved.distance == pytest.approx(2.82, abs=0.05)
        # The bumper is still pressed.
        assert robot.forward(0.1, tolerance=0.004)[::2] == (0.0, True)
        assert not robot.forward(-0.3, tolerance=0.004).bumped
        assert Beats.last.command[1:] == [
            *("-m", "jaxcell.robot.ros.watchdog", kind, "2.0", "Twist"),
            *("--ros-args", "-r", "__ns:=/one"),
        ]
    assert world.said[0] == ("init", "--ros-args", "-r", "__ns:=/one")
    assert world.said[-2:] == [("destroyed", "jaxcell"), ("shutdown",)]
    assert Beats.last.dismissed
    assert world.goal is None


@pytest.mark.parametrize("silent", ["odometry", "bumper"])
def test_a_robot_that_falls_silent_is_stopped(world, kind, silent):
    with KINDS[kind](patience=1.0) as robot:
        robot.arm()
        topic = "odom" if silent == "odometry" else robot.contact
        reason = "no odometry for 1 s" if topic == "odom" else f"no {topic} for 1 s"
        when(lambda: world.body.x > 1.1, lambda: world.silent.add(topic))
        with pytest.raises(RobotStopped, match=reason):
            # Without the stop, the robot would push against the wall until its time is over.
            robot.forward(90.0, tolerance=0.004)
        wait_until(lambda: world.goal is None)
        with pytest.raises(RobotStopped, match=reason):
            robot.arm()
        world.silent.clear()
        await_ticks(world)
        with pytest.raises(RobotStopped, match=reason):
            robot.forward(0.1, tolerance=0.004)
        robot.arm()
        assert robot.forward(-0.1, tolerance=0.004).distance == pytest.approx(-0.1, abs=0.01)


def test_a_robot_whose_bumper_does_not_report_is_not_armed(world, kind):
    world.silent = {KINDS[kind].contact}
    with KINDS[kind]() as robot:
        robot.answer = 0.1
        with pytest.raises(RobotStopped, match=f"nothing comes on /{robot.contact}, so it would"):
            robot.arm()
        with pytest.raises(RobotStopped, match="it is not armed"):
            robot.forward(2.5, tolerance=0.004)
        robot.answer = 60.0
        world.silent = set()
        robot.arm()
        assert robot.forward(9.0, tolerance=0.004).bumped


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({"battery": 0.05}, r"the battery is low \(5%\)"),
        ({"battery": 0.9, "charging": True}, "it is on the charger"),
        ({"docked": True}, "it is on the dock"),
    ],
    ids=["low", "charger", "dock"],
)
def test_a_low_battery_or_a_charger_stops_a_robot(world, kind, message, reason):
    def hears(values):
        vars(world).update(values)
        await_ticks(world)

    with KINDS[kind]() as robot:
        robot.arm()
        hears({"battery": 0.11})
        robot.forward(0.1, tolerance=0.004)
        hears(message)
        if kind == "base" and "docked" in message:
            # A base has no message for a dock.
            robot.forward(0.1, tolerance=0.004)
            return
        with pytest.raises(RobotStopped, match=reason):
            robot.forward(0.1, tolerance=0.004)
        with pytest.raises(RobotStopped, match=reason):
            robot.arm()
        hears({"battery": 0.5, "charging": False, "docked": False})
        robot.arm()
        robot.forward(0.1, tolerance=0.004)


def test_speeds_have_the_type_to_which_the_base_subscribes(world_of):
    world = world_of((1.0, 1.5, 0.0), "base")
    world.speeds = ["geometry_msgs/msg/TwistStamped"]
    with Base() as robot:
        robot.arm()
        assert robot.forward(0.5, tolerance=0.004).distance == pytest.approx(0.5, abs=0.01)
        assert Beats.last.command[4:6] == ["2.0", "TwistStamped"]
    assert world.published["cmd_vel"][0].header.frame_id == "base_link"


def test_dangers_stop_a_create_3_until_it_is_armed_again(world_of):
    world = world_of((1.0, 1.5, 0.0), "create3")
    with Create3() as robot:
        robot.arm()
        when(lambda: world.body.x > 1.1, lambda: world.hazards.add(CLIFF))
        with pytest.raises(RobotStopped, match="there is a cliff"):
            robot.forward(2.5, tolerance=0.004)
        assert world.goal is None
        x = world.body.x
        assert 1.0 < x < 3.0
        with pytest.raises(RobotStopped, match="there is a cliff"):
            robot.arm()
        world.hazards.clear()
        await_ticks(world)
        robot.arm()
        # A robot may reach its backup limit without a backward drive.
        world.hazards.add(BACKUP_LIMIT)
        await_ticks(world)
        assert robot.forward(0.1, tolerance=0.004).distance == pytest.approx(0.1, abs=0.01)
        with pytest.raises(RobotStopped, match="safety_override must be backup_only"):
            robot.forward(-0.1, tolerance=0.004)
        world.hazards.clear()
        await_ticks(world)
        robot.arm()
        world.refuses = True
        with pytest.raises(RobotStopped, match="the robot refuses the goal"):
            robot.turn(1.0, tolerance=0.01)


def test_a_signal_that_ends_the_block_stops_the_robot(world, kind):

    def interrupted():
        with KINDS[kind]() as robot:
            robot.arm()
            when(lambda: world.body.x > 1.1, lambda: os.kill(os.getpid(), signal.SIGTERM))
            robot.forward(2.5, tolerance=0.004)

    with pytest.raises(SystemExit):
        interrupted()
    assert world.goal is None
    assert ("cancel",) in world.said if kind == "create3" else world.speed == (0.0, 0.0)
    assert world.body.x < 3
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_signal_handlers_are_restored_if_closing_fails(world_of, monkeypatch):
    def dismiss(self):
        raise OSError("the watchdog does not end")

    monkeypatch.setattr(Beats, "dismiss", dismiss)
    world_of((1.0, 1.5, 0.0), "base")
    with pytest.raises(OSError, match="does not end"), Base():
        assert signal.getsignal(signal.SIGTERM) != signal.SIG_DFL
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@pytest.mark.parametrize(
    ("kind", "lack", "wait", "message"),
    [
        ("base", {"speeds": []}, "answer", "nothing subscribes to speeds on /cmd_vel"),
        ("create3", {"dead": True}, "greeting", r"no odometry comes on /odom: .* ROS_DOMAIN_ID 0"),
    ],
)
def test_a_robot_without_odometry_or_a_topic_of_speeds_is_refused(world, kind, lack, wait, message):
    vars(world).update(lack)
    robot = KINDS[kind]()
    setattr(robot, wait, 0.1)
    with pytest.raises(ConnectionError, match=message):
        robot.__enter__()


def test_a_missing_installation_of_ros_is_an_error_with_a_remedy():
    with pytest.raises(ModuleNotFoundError, match=r"^ROS 2 is not set up; first run: source "):
        Create3().__enter__()


def test_check_names_the_command_that_sets_a_create_3(world_of, capsys):
    world = world_of((1.0, 1.5, 0.0), "create3")
    words = ["robot", "check", "--ros", "create3", "--json"]
    bump = "ros2 param set /motion_control reflexes.REFLEX_BUMP false"
    backup = "ros2 param set /motion_control safety_override backup_only"
    needs = "a run needs other settings: "

    def checked():
        status = main(words)
        danger = json.loads(capsys.readouterr().out)["danger"]
        assert status == (danger is not None)
        return danger

    assert checked() == f"{needs}{backup} && {bump}"
    world.settings["reflexes.REFLEX_BUMP"] = False
    assert checked() == needs + backup
    world.settings["safety_override"] = "full"
    assert checked() == needs + backup
    world.settings["safety_override"] = "backup_only"
    assert checked() is None
    assert main(words[:-1]) == 0
    assert re.search(r"safety_override +│ backup_only", capsys.readouterr().out)
    world.docked = True
    assert checked() == "it is on the dock"
    world.docked = False
    world.settings["reflexes.REFLEX_BUMP"] = True
    assert checked() == needs + bump
    del world.settings["safety_override"]
    assert checked() == f"{needs}{backup} && {bump}"
    world.silent.add("motion_control/get_parameters")
    assert checked() == "/motion_control does not answer: is --remap right?"


def test_the_watchdog_stops_a_robot_whose_driver_is_gone(tmp_path, kind):
    (tmp_path / "rclpy.py").write_text("import ros_stub\n\nros_stub.install()\n")
    log = tmp_path / "said"
    paths = [tmp_path, Path(ros_stub.__file__).parent, Path(__file__).parents[3]]
    place = {"PYTHONPATH": os.pathsep.join(map(str, paths)), "ROS_STUB_LOG": str(log)}
    main = (
        "import sys, time; from jaxcell.robot.create.watchdog import Watchdog; "
        "w = Watchdog([sys.executable, '-m', 'jaxcell.robot.ros.watchdog', "
        f"{kind!r}, '60', 'Twist']); "
        "w.beat(); print('ready', flush=True); time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", main], stdout=subprocess.PIPE, env={**os.environ, **place}
    ) as driver:
        assert driver.stdout.readline() == b"ready\n"
        said = log.read_text()
        assert "cancel" not in said
        driver.kill()
    wait_until(lambda: "shutdown" in log.read_text())
    said = log.read_text()
    assert ("cancel" in said) is (kind == "create3")
    assert "cmd_vel 0.0 0.0" in said
    assert said.endswith("destroyed jaxcell_watchdog\nshutdown\n")


def test_the_command_line_drives_a_robot_and_publishes_candidates(world_of, tmp_path, capsys, kind):
    world = world_of(pose_of(LAB, 70), kind, LAB.workspace)
    path = save_filter(tmp_path, map=str(MAPS / "lab_a.json"), name=LAB.workspace.name)
    words = ["robot", "run", str(path), "--ros", kind, "--heading", "135", "--json"]
    assert main([*words, "--remap", "__ns:=/one"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["result"], result["port"]) == ("localized", f"ROS 2, {kind}")
    assert int(LAB.index(*world.body.pose)) in result["cells"]
    assert world.said[0] == ("init", "--ros-args", "-r", "__ns:=/one")
    arrays, grids = world.published["candidates"], world.published["candidate_squares"]
    assert len(arrays) == len(grids) == len(result["observations"])
    cells = {int(LAB.index(*plane(pose))) for pose in arrays[-1].poses}
    assert cells == set(result["cells"])
    grid = np.array(grids[-1].data).reshape(grids[-1].info.height, grids[-1].info.width)
    assert grids[-1].info.resolution == 1.0
    assert (grid >= 0).tolist() == LAB.free.tolist()
    here = {cell % LAB.positions for cell in cells}
    assert set(np.flatnonzero(grid[LAB.free] == 100)) == here
    assert arrays[-1].header.frame_id == grids[-1].header.frame_id == "map"


def test_a_patrol_and_a_plan_publish_where_the_robot_is(world_of, tmp_path):
    world = world_of((0.5, 0.5, 0.0), "base", LAB.workspace)
    walk = np.int32([np.arange(LAB.positions)]), np.ones((1, LAB.positions))
    save_patrols(tmp_path / "patrol.json", LAB, [walk], [0], 1.0)
    plan = tmp_path / "summary.json"
    plan.write_text(json.dumps({**SPEC, "found": True, "start": 3, "actions_deg": [0]}))
    with Base() as robot:
        patrol = Candidates(robot, load_task(tmp_path / "patrol.json"), None)
        patrol.event("observation", {"observation": 0, "way": 1, "position": 4})
        patrol.event("end", {})
        fields = {"observation": 0, "estimate": [1.0, -0.5, math.pi / 2]}
        Candidates(robot, load_task(plan), None).event("observation", fields)
    position, estimate = world.published["candidates"]
    x, y, _ = map(float, LAB.centre(4))
    assert plane(position.poses[0]) == pytest.approx((x, y, math.pi / 2))
    assert estimate.header.frame_id == "start"
    assert plane(estimate.poses[0])[:2] == (1.0, -0.5)
    assert len(world.published["candidate_squares"]) == 1
