"""Times how long a bump takes to stop the wheels: from its byte on the line to the stop command.

Run `python experiments/benchmarks/bench_latency.py`; it takes half a minute, and with `--full`,
10,000 bumps, three.

The emulated robot is in a process of its own, as a real one would be, at the other end of a
pseudo-terminal. It presses its bumper as soon as it drives. Both times are taken there: when the
first frame of the stream that tells of the bump has been written, and when the command that stops
the wheels has been read. In between are the pseudo-terminal, pySerial, the driver and two process
switches. To a real robot come the transfers, at 115200 baud 2.3 ms for a frame and 0.4 ms for a
command, and up to 15 ms until the next frame. The robot's time runs at twice the clock, so that
frames come every 7.5 ms.

On a machine that is busy with other work this times its scheduler: `chrt -f 10 python ...`, or
`CPUSchedulingPolicy=fifo` in a unit of systemd, lets both processes run first.
"""

import contextlib
import multiprocessing
import os
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from rows import Row, options, write_rows

from jaxcell.robot import Contact, Create
from jaxcell.robot.create.open_interface import HEADER, Command
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.space import Workspace


MOST_P99 = 0.020
SPEEDUP = 2.0


class Bumping(Emulator):
    """A robot that bumps as soon as it drives, until it is stopped."""

    def __init__(self) -> None:
        # It drives for 8 ms between two bumps.
        room = Workspace([(0, 0), (100, 0), (100, 1), (0, 1)])
        super().__init__(Body(room, (0.5, 0.5, 0.0)), line=Line(speedup=SPEEDUP))
        self.seconds_to_stop: list[float] = []
        self._told: float | None = None

    def _send(self, data: bytes) -> None:
        super()._send(data)
        if self.contact and self._told is None and data[0] == HEADER:
            self._told = time.perf_counter()

    def _do(self, command: Command) -> None:
        super()._do(command)
        if any(self.wheels):
            self.contact = Contact.BUMP_LEFT
        elif self._told is not None:
            self.seconds_to_stop.append(time.perf_counter() - self._told)
            self._told, self.contact = None, Contact(0)


def robot(bumps: int, pipe: Connection) -> None:
    with Bumping() as emulator:
        pipe.send(emulator.port)
        while len(emulator.seconds_to_stop) < bumps:
            time.sleep(0.05)
        pipe.send(emulator.seconds_to_stop[:bumps])
        # Until the host has closed the line.
        pipe.recv()


def host(port: str, pipe: Connection) -> list[float]:
    """Drives on after every bump."""
    # On a busy machine the robot itself may be late.
    with Create.open(port, patience=10.0) as create:
        create.arm()
        while not pipe.poll():
            if not create.drive(right=0.05, left=0.05, stop_on_bump=True):
                create.stop()
                while create.sensors().bump and not pipe.poll():
                    time.sleep(0.001)
            time.sleep(0.001)
    seconds: list[float] = pipe.recv()
    pipe.send(None)
    return seconds


def draw(seconds: np.ndarray, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    milliseconds = 1000 * seconds
    low, high = milliseconds.min(), max(milliseconds.max(), 1000 * MOST_P99)
    axes.hist(milliseconds, np.geomspace(low, 1.1 * high, 80), color="#0072b2")
    for name, at, color in (
        ("p50", np.quantile(milliseconds, 0.5), "#009e73"),
        ("p99", np.quantile(milliseconds, 0.99), "#d55e00"),
        ("most that p99 may be", 1000 * MOST_P99, "black"),
    ):
        axes.axvline(at, color=color, label=f"{name}: {at:.3g} ms")
    axes.set(xscale="log", yscale="log", xlabel="bump byte to stop command, ms", ylabel="bumps")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = options(__doc__, 1, "10,000 bumps instead of 1,500")
    parser.add_argument("--out", type=Path, help="directory for a histogram, latency.png")
    arguments = parser.parse_args()
    bumps = 10_000 if arguments.full else 1_500
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=robot, args=(bumps, theirs), daemon=True)
    process.start()
    with contextlib.closing(ours):
        seconds = np.array(host(ours.recv(), ours))
    process.join()
    p50, p99 = np.quantile(seconds, [0.5, 0.99])
    print("\n| bumps | p50, ms | p99, ms | max, ms |\n|--:|--:|--:|--:|")
    print(f"| {bumps:,} | {1e3 * p50:.2f} | {1e3 * p99:.2f} | {1e3 * seconds.max():.2f} |")
    size = f"{bumps:,} bumps"
    write_rows(
        arguments.rows,
        [
            Row("latency", "bump byte to stop command, median", size, float(p50)),
            Row("latency", "bump byte to stop command, 99th percentile", size, float(p99)),
        ],
    )
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        draw(seconds, arguments.out / "latency.png")
    verdict = "under" if p99 < MOST_P99 else "NOT UNDER"
    print(f"\nThe 99th percentile is {verdict} {1e3 * MOST_P99:g} ms.")


if __name__ == "__main__":
    main()
