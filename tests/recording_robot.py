"""An emulated robot that records its commands, for tests of the programs that drive it."""

from jaxcell.robot.create.open_interface import Command
from jaxcell.robot.emulation.emulator import Emulator, Moving


class RecordingRobot(Emulator):
    def __init__(self, body: Moving, *, first_mode: int = 0, **fields) -> None:
        super().__init__(body, **fields)
        self.first_mode = first_mode
        "The number of mode Off."
        self.commands: list[tuple[float, Command]] = []
        "The commands so far, with their times in seconds of the robot."
        self.deaf = False
        "True if the robot ignores commands."
        self.mute = False
        "True if the robot sends nothing."

    @property
    def last_opcodes(self) -> list[int]:
        """The opcodes of the last two commands."""
        return [command.opcode for _, command in self.commands[-2:]]

    def _do(self, command: Command) -> None:
        if not self.deaf:
            self.commands.append((self.seconds, command))
            super()._do(command)

    def _send(self, data: bytes) -> None:
        if not self.mute:
            super()._send(data)

    def _values(self) -> dict[str, int]:
        values = super()._values()
        return {**values, "mode": values["mode"] + self.first_mode}
