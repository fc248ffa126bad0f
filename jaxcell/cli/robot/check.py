import contextlib
import dataclasses
from typing import Any, ClassVar

from ..output import Printing
from ..terminal import status, table


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotCheck(Printing):
    """Read the sensors of a robot: battery, contacts, cliffs."""

    example: ClassVar[str] = "--port /dev/ttyUSB0"

    port: str
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    firmware: bool = False
    """Reboot the robot to read its firmware version; the reboot takes ten seconds."""
    move: bool = False
    """Drive 10 cm forward and back."""

    def run(self) -> int:
        from ...robot import Create, RobotStopped

        state: dict[str, Any] = {"port": self.port}
        if self.firmware:
            state["firmware"] = self._firmware()
        try:
            with Create.open(self.port) as robot:
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
        rows = [(name, str(value)) for name, value in state.items()]
        self.report(state, lambda: table(f"The robot at {self.port}", ("", ""), rows))
        return 0 if state["danger"] is None else 1

    def _firmware(self) -> str:
        from ...robot.create.line import firmware, open_line

        with (
            contextlib.closing(open_line(self.port)) as line,
            status("waiting for the robot to reboot"),
        ):
            return firmware(line)
