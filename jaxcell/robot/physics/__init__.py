"""A Create 2 in a physics engine, which the driver controls with the same bytes as a real robot.

A [`PhysicsBody`][] is a body for the `jaxcell.robot.emulation.emulator.Emulator`. Its wheels roll
on a floor with friction, springs hold its bumper, and a bump turns it. Therefore the driver,
filters and beliefs meet errors that their own models do not contain. It needs MuJoCo: `pip install
'jaxcell[physics]'`.

| quantity | source |
| --- | --- |
| wheels, track, diameter, mass | published descriptions of the Create 2 |
| frames every 15 ms, encoders of 508.8 counts | the Open Interface |
| friction, springs and switches of the bumper, latency | assumed: [`Physics`][] |

Friction, springs and switches determine the turn of the robot at a bump. `docs/pages/physics.md`
describes the effect of each assumption, and ten measurements on a real robot that would test them.
"""

from .body import PhysicsBody as PhysicsBody
from .model import LATENCY as LATENCY, RADIUS as RADIUS, Physics as Physics
