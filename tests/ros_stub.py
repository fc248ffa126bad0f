"""A substitute for `rclpy` and messages of ROS 2, with a robot in a map: `install(World(...))`.

As in rclpy, messages refuse values that do not have the types of their definitions, and callbacks
run in the thread that spins. Messages have the fields that jaxcell uses, and some others.
"""

import enum
import math
import os
import sys
import threading
import time
import types
from concurrent.futures import Future

from jaxcell.robot.create.packets import WHEEL_BASE


# The fields of each message, by name and type.
DEFINITIONS = """
builtin_interfaces.msg.Time: sec int, nanosec int
std_msgs.msg.Header: stamp builtin_interfaces.msg.Time, frame_id str
std_msgs.msg.Bool: data bool
geometry_msgs.msg.Vector3: x float, y float, z float
geometry_msgs.msg.Point: x float, y float, z float
geometry_msgs.msg.Quaternion: x float, y float, z float, w float
geometry_msgs.msg.Pose: position geometry_msgs.msg.Point, orientation geometry_msgs.msg.Quaternion
geometry_msgs.msg.PoseWithCovariance: pose geometry_msgs.msg.Pose
geometry_msgs.msg.PoseArray: header std_msgs.msg.Header, poses list
geometry_msgs.msg.Twist: linear geometry_msgs.msg.Vector3, angular geometry_msgs.msg.Vector3
geometry_msgs.msg.TwistStamped: header std_msgs.msg.Header, twist geometry_msgs.msg.Twist
sensor_msgs.msg.BatteryState: header std_msgs.msg.Header, percentage float, power_supply_status int
nav_msgs.msg.Odometry: header std_msgs.msg.Header, pose geometry_msgs.msg.PoseWithCovariance
nav_msgs.msg.MapMetaData: resolution float, width int, height int, origin geometry_msgs.msg.Pose
nav_msgs.msg.OccupancyGrid: header std_msgs.msg.Header, info nav_msgs.msg.MapMetaData, data list
irobot_create_msgs.msg.HazardDetection: header std_msgs.msg.Header, type int
irobot_create_msgs.msg.HazardDetectionVector: header std_msgs.msg.Header, detections list
irobot_create_msgs.msg.DockStatus: header std_msgs.msg.Header, is_docked bool
irobot_create_msgs.action.DriveDistance.Goal: distance float, max_translation_speed float
irobot_create_msgs.action.RotateAngle.Goal: angle float, max_rotation_speed float
action_msgs.msg.GoalInfo: stamp builtin_interfaces.msg.Time
action_msgs.srv.CancelGoal.Request: goal_info action_msgs.msg.GoalInfo
rcl_interfaces.msg.ParameterValue: type int, bool_value bool, string_value str
rcl_interfaces.srv.GetParameters.Request: names list
rcl_interfaces.srv.GetParameters.Response: values list
"""

NAMES = {bool: "bool", str: "string"}
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
BACKUP_LIMIT, BUMP, CLIFF, STALL, WHEEL_DROP = range(5)
TICK = 0.02


class Message:
    def __init__(self, **values):
        for name, kind in self.fields.items():
            setattr(self, name, values.get(name, CLASSES[kind]()))

    def __setattr__(self, name, value):
        kind = CLASSES[self.fields[name]]
        assert type(value) is kind, f"{type(self).__name__}.{name}: {value!r} is no {kind.__name__}"
        object.__setattr__(self, name, value)


CLASSES = {kind.__name__: kind for kind in (bool, int, float, str, list)}
for line in DEFINITIONS.split("\n")[1:-1]:
    message, fields = line.split(": ")
    kinds = dict(field.split() for field in fields.split(", "))
    CLASSES[message] = type(message.rpartition(".")[2], (Message,), {"fields": kinds})


class World:
    """A Create 3 or another base with a body, whose time passes by ticks."""

    def __init__(self, body=None, *, kind="create3", pause=0.0005):
        self.body, self.kind, self.pause = body, kind, pause
        self.hazards = set()
        self.silent = set()
        self.battery, self.charging, self.docked = math.nan, False, False
        self.speeds = ["geometry_msgs/msg/Twist"]
        self.dead = self.refuses = False
        self.settings = {"safety_override": "none", "reflexes.REFLEX_BUMP": True}
        self.said, self.published = [], {}
        self.goal = None
        self.speed, self.expires = None, 0.0
        self.now = 0.0
        self.log = os.environ.get("ROS_STUB_LOG")

    def say(self, *words):
        self.said.append(words)
        if self.log:
            with open(self.log, "a") as file:
                file.write(" ".join(map(str, words)) + "\n")

    def take(self, name, goal, result):
        assert self.goal is None, "two goals at once"
        self.say("goal", name)
        distance = getattr(goal, "distance", 0.0)
        angle = getattr(goal, "angle", 0.0)
        start = self.body.travelled.mean(), self.body.theta
        self.goal = (distance, angle, start, result)

    def end(self, status):
        if self.goal is not None:
            result, self.goal = self.goal[3], None
            self.say("ended", status)
            result.set_result(types.SimpleNamespace(status=status))

    def answer(self, names):
        """The values of settings; a node that lacks one of them sends none."""
        value, kinds = CLASSES["rcl_interfaces.msg.ParameterValue"], {bool: 1, str: 4}
        known = [self.settings[name] for name in names if name in self.settings]
        values = [value(type=kinds[type(x)], **{f"{NAMES[type(x)]}_value": x}) for x in known]
        values = values if len(values) == len(names) else []
        return CLASSES["rcl_interfaces.srv.GetParameters.Response"](values=values)

    def cancel(self):
        self.say("cancel")
        self.end(CANCELED)

    def roll(self, twist):
        twist = getattr(twist, "twist", twist)
        if (twist.linear.x, twist.angular.z) != self.speed:
            self.say("cmd_vel", round(twist.linear.x, 3), round(twist.angular.z, 3))
        self.speed, self.expires = (twist.linear.x, twist.angular.z), self.now + 0.5

    def wanted(self):
        if self.goal is None:
            return self.speed if self.now < self.expires else (0.0, 0.0)
        distance, angle, (travelled, theta), _ = self.goal
        ahead = distance - (self.body.travelled.mean() - travelled)
        left = angle - (self.body.theta - theta)
        if abs(ahead) < 0.002 and abs(left) < 0.005:
            self.end(SUCCEEDED)
            return 0.0, 0.0
        return bounded(4 * ahead, 0.02, 0.2, distance), bounded(4 * left, 0.1, 1.0, angle)

    def tick(self, node):
        if self.body is None or self.dead:
            return
        self.now += TICK
        if self.hazards & {CLIFF, STALL, WHEEL_DROP}:
            self.end(ABORTED)
        forward, left = self.wanted()
        half = left * WHEEL_BASE / 2
        self.body.advance(forward - half, forward + half, TICK)
        odometry = CLASSES["nav_msgs.msg.Odometry"]()
        pose = odometry.pose.pose
        pose.position.x, pose.position.y = float(self.body.x), float(self.body.y)
        pose.orientation.z = math.sin(self.body.theta / 2)
        pose.orientation.w = math.cos(self.body.theta / 2)
        node.hear("odom", odometry)
        state = {"percentage": self.battery, "power_supply_status": int(self.charging)}
        node.hear("battery_state", CLASSES["sensor_msgs.msg.BatteryState"](**state))
        bump = self.body.bump_left or self.body.bump_right
        if self.kind == "base":
            node.hear("bumper", CLASSES["std_msgs.msg.Bool"](data=bump))
            return
        dock = CLASSES["irobot_create_msgs.msg.DockStatus"](is_docked=self.docked)
        node.hear("dock_status", dock)
        hazard = CLASSES["irobot_create_msgs.msg.HazardDetection"]
        kinds = sorted(self.hazards | ({BUMP} if bump else set()))
        detections = [hazard(type=int(kind)) for kind in kinds]
        vector = CLASSES["irobot_create_msgs.msg.HazardDetectionVector"](detections=detections)
        node.hear("hazard_detection", vector)


def bounded(speed, least, most, whole):
    return 0.0 if whole == 0 else math.copysign(min(max(abs(speed), least), most), speed)


class Node:
    def __init__(self, world, name):
        self.world, self.name = world, name
        self.heard, self.todo = {}, []

    def create_subscription(self, kind, topic, callback, qos):
        self.heard[topic] = kind, callback

    def hear(self, topic, message):
        if topic in self.heard and topic not in self.world.silent:
            kind, callback = self.heard[topic]
            assert type(message) is kind
            callback(message)

    def create_publisher(self, kind, topic, qos):
        def publish(message):
            assert type(message) is kind
            # A subscription receives messages of its own type only.
            if topic == "cmd_vel" and f"geometry_msgs/msg/{kind.__name__}" in self.world.speeds:
                self.world.roll(message)
            self.world.published.setdefault(topic, []).append(message)

        return types.SimpleNamespace(publish=publish)

    def create_client(self, service, name):
        def call(request):
            assert type(request) is service.Request
            answer = Future()
            if name == "motion_control/get_parameters":
                self.todo.append(lambda: answer.set_result(self.world.answer(request.names)))
                return answer
            assert name.endswith("/_action/cancel_goal")
            self.todo.append(lambda: (self.world.cancel(), answer.set_result(None)))
            return answer

        there = name not in self.world.silent
        return types.SimpleNamespace(call_async=call, wait_for_service=lambda timeout_sec: there)

    def get_subscriptions_info_by_topic(self, topic):
        assert topic == "/cmd_vel"
        return [types.SimpleNamespace(topic_type=kind) for kind in self.world.speeds]

    def resolve_topic_name(self, topic):
        return f"/{topic}"

    def resolve_service_name(self, name):
        return f"/{name}"

    def get_clock(self):
        stamp = CLASSES["builtin_interfaces.msg.Time"]()
        now = types.SimpleNamespace(to_msg=lambda: stamp)
        return types.SimpleNamespace(now=lambda: now)

    def destroy_node(self):
        self.world.say("destroyed", self.name)

    def turn(self):
        while self.todo:
            self.todo.pop(0)()
        self.world.tick(self)


class ActionClient:
    def __init__(self, node, kind, name):
        self.node, self.kind, self.name = node, kind, name

    def wait_for_server(self, timeout_sec):
        return not self.node.world.dead

    def send_goal_async(self, goal):
        assert type(goal) is self.kind.Goal
        sent, result, world = Future(), Future(), self.node.world

        def accept():
            if not world.refuses:
                world.take(self.name, goal, result)
            handle = types.SimpleNamespace(
                accepted=not world.refuses,
                get_result_async=lambda: result,
                cancel_goal_async=lambda: self.node.todo.append(world.cancel),
            )
            sent.set_result(handle)

        self.node.todo.append(accept)
        return sent


class Executor:
    def __init__(self):
        self.nodes, self.closing = [], threading.Event()

    def add_node(self, node):
        self.nodes.append(node)

    def spin(self):
        while not self.closing.is_set():
            for node in self.nodes:
                node.turn()
                time.sleep(node.world.pause)

    def shutdown(self):
        self.closing.set()


def install(world=None, modules=sys.modules):
    """Make the modules of ROS importable, with nodes in a world."""
    world = world or World()
    made = {}

    def module(name):
        if name not in made:
            made[name] = modules[name] = types.ModuleType(name)
            made[name].__path__ = []
            parent, _, last = name.rpartition(".")
            if parent:
                setattr(module(parent), last, made[name])
        return made[name]

    for name, kind in CLASSES.items():
        if not issubclass(kind, Message):
            continue
        package, inner, *path = name.split(".")
        place = module(f"{package}.{inner}")
        for part in path[:-1]:
            if not hasattr(place, part):
                setattr(place, part, type(part, (), {}))
            place = getattr(place, part)
        setattr(place, path[-1], kind)
    rclpy = module("rclpy")
    rclpy.init = lambda *, args, signal_handler_options: world.say("init", *args)
    rclpy.create_node = lambda name: Node(world, name)
    rclpy.spin_once = lambda node, timeout_sec: node.turn()
    rclpy.shutdown = lambda: world.say("shutdown")
    module("rclpy.action").ActionClient = ActionClient
    module("rclpy.executors").SingleThreadedExecutor = Executor
    qos = module("rclpy.qos")
    qos.qos_profile_sensor_data = "sensors"
    qos.DurabilityPolicy = enum.Enum("DurabilityPolicy", "TRANSIENT_LOCAL")
    qos.QoSProfile = lambda *, depth, durability: (depth, durability)
    module("rclpy.signals").SignalHandlerOptions = enum.Enum("SignalHandlerOptions", "NO")
    return world
