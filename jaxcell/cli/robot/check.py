import contextlib
import dataclasses
from typing import Annotated, Any, ClassVar, Literal

from ...study.parameters import Only, check
from ..output import Printing
from ..terminal import status, table


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotCheck(Printing):
    """Read the sensors of a robot: battery, contacts, cliffs; or the settings of a Create 3."""

    example: ClassVar[str] = "--port /dev/ttyUSB0"
    one_of: ClassVar[tuple[str, ...]] = ("port", "ros")

    port: str | None = None
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    ros: Annotated[Literal["create3"] | None, Only(port=False)] = None
    """Ask a Create 3 or a TurtleBot 4 on ROS 2 for the two settings that a run needs."""
    remap: Annotated[tuple[str, ...], Only(ros=True)] = ()
    """Rules that rename topics of ROS, such as __ns:=/robot1."""
    firmware: Annotated[bool, Only(ros=False)] = False
    """Reboot the robot to read its firmware version; the reboot takes ten seconds."""
    move: Annotated[bool, Only(ros=False)] = False
    """Drive 10 cm forward and back."""

    def run(self) -> int:
        check(self)
        state = self._of_ros() if self.port is None else self._on_line(self.port)
        rows = [(name, str(value)) for name, value in state.items()]
        self.report(state, lambda: table(f"The robot at {self.port or 'ROS 2'}", ("", ""), rows))
        return 0 if state["danger"] is None else 1

    def _of_ros(self) -> dict[str, Any]:
        from ...robot import RobotStopped, ros

        state: dict[str, Any] = {"ros": self.ros, "danger": None}
        try:
            with ros.Create3(remap=self.remap) as robot:
                settings, command = robot.settings()
                state |= settings
                if command:
                    raise RobotStopped(f"a run needs other settings: {command}")
                robot.arm()
        except RobotStopped as error:
            state["danger"] = str(error)
        return state

    def _on_line(self, port: str) -> dict[str, Any]:
        from ...robot import Create, RobotStopped

        state: dict[str, Any] = {"port": port}
        if self.firmware:
            state["firmware"] = self._firmware(port)
        try:
            with Create.open(port) as robot:
                now = robot.sensors()
                state |= {
                    "mode": now.mode.name.lower(),
                    "battery_percent": round(100 * now.battery, 1),
                    "voltage_V": now.voltage,
                    "charging_state": now.charging_state,
                    "charger": now.charger,
                    "contact": [flag.name.lower() for flag in now.contact if flag.name],
                    "cliff": list(now.cliff),
                    "encoders": list(now.encoders),
                    "danger": now.danger,
                }
                if self.move:
                    robot.arm()
                    for name, distance in ("forward_m", 0.1), ("back_m", -0.1):
                        moved = robot.forward(distance)
                        state[name] = round(moved.distance, 4)
                        state["bumped"] = moved.bumped
        except RobotStopped as error:
            state["danger"] = str(error)
        return state

    def _firmware(self, port: str) -> str:
        from ...robot.create.line import firmware, open_line

        with (
            contextlib.closing(open_line(port)) as line,
            status("waiting for the robot to reboot"),
        ):
            return firmware(line)
