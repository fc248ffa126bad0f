"""A Create 2 in a physics engine, behind the same bytes as the emulated robot.

A [`PhysicsBody`][] is a body for the `jaxcell.robot.emulation.emulator.Emulator`, in
place of one that geometry moves. Its wheels roll on the floor by friction, its bumper goes in
against springs, and a bump turns it. So the driver, the runner, filters and beliefs meet what they
were not made with. It needs MuJoCo: `pip install 'jaxcell[physics]'`.

| quantity | known from |
| --- | --- |
| wheels, track, diameter, mass | published descriptions of the Create 2 |
| frames every 15 ms, encoders of 508.8 counts | the Open Interface |
| friction, springs and switches of the bumper, latency | assumed: [`Physics`][] |

Friction, springs and switches decide by how much a bump turns the robot. `docs/pages/physics.md`
says how much depends on each, and has ten measurements on a real robot that decide between them.
"""

from .body import PhysicsBody as PhysicsBody
from .model import LATENCY as LATENCY, RADIUS as RADIUS, Physics as Physics
