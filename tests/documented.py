"""Substitutes for documented commands that cannot run in a test as written.

A test runs every other line of a page as written.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
import tomllib
import urllib.request
from pathlib import Path
from unittest import mock

from distributed import LocalCluster
from packaging.requirements import Requirement
from wheels import body_in, map_cells

from jaxcell.cli import main
from jaxcell.robot.emulation.emulator import Emulator, Line


ROOT = Path(__file__).parents[1]
# The centre of a cell at the left of the topmost row of the lab, towards East.
LAB, START = map_cells("lab_a.json"), (0.5, 3.5, 0.0)


def in_a_browser(line):
    """Serve a page for a browser in place of a window; read it once, and close it."""
    words = shlex.split(line)
    words += ["--web"] * ("view" in words and "--web" not in words)
    words += ["--speedup", "1000"] * ("--simulate" in words)
    hidden = {"DISPLAY", "WAYLAND_DISPLAY"}
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    command = [sys.executable, "-m", *words]
    pipe = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, **pipe) as process:
        try:
            address = awaited(process, r"(http://\S+)\?url=rerun")[1]
            with urllib.request.urlopen(address) as page:
                assert "Rerun" in page.read().decode()
            if "--live" in words:
                awaited(process, "The page stays until Ctrl-C")
        finally:
            process.send_signal(signal.SIGTERM)
            rest = process.stderr.read()
    assert process.returncode == 128 + signal.SIGTERM, rest


def awaited(process, wanted):
    """The first match of a pattern in the lines of a process on standard error."""
    lines = []
    for line in process.stderr:
        lines.append(line)
        if match := re.search(wanted, line):
            return match
    raise AssertionError(f"{process.args} ended without {wanted}:\n{''.join(lines)}")


def on_an_emulated_line(line):
    """Drive an emulated robot on a pseudo-terminal; the answers to questions are 1 m and 360."""
    body = body_in(LAB, int(LAB.index(*START)))
    with (
        Emulator(body, line=Line(speedup=20.0)) as robot,
        mock.patch("builtins.input", side_effect=["1.0", "360"]),
    ):
        assert main(shlex.split(line.replace("/dev/ttyUSB0", robot.port))[1:]) == 0, line


def on_a_cluster_of_this_machine(line):
    """Use a scheduler in this process."""
    options = {"processes": False, "protocol": "tcp://", "dashboard_address": ":0"}
    with LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        assert main(shlex.split(line.replace("dask://scheduler:8786", address))[1:]) == 0, line


def with_fewer_rooms(line):
    """Run a sweep of a thousandth of the rooms, which would take minutes."""
    path = Path(shlex.split(line)[2])
    path.write_text(
        path.read_text().replace("125000", "125").replace("count = 1000 ", "count = 1 ")
    )
    assert main(shlex.split(line)[1:]) == 0, line


def with_known_extras(line):
    """Check the requirement and its extras against the project, without an installation."""
    (wanted,) = shlex.split(line.removeprefix("pip install "))
    requirement = Requirement(re.sub(r"^\.", "jaxcell", wanted))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert requirement.name == project["name"]
    assert requirement.extras <= set(project["optional-dependencies"])


def of_a_recipe(line):
    """Check that CI or a test runs the recipe of a target of the Makefile."""
    target = line.removeprefix("make ")
    recipes = {"demo": ("tests/cli/test_demo.py", 'main(["demo"'), "test": (".ci/run", "make test")}
    place, text = recipes[target]
    assert text in (ROOT / place).read_text()


# Substitutes, by a part of the line.
SUBSTITUTES = {
    "jaxcell view ": in_a_browser,
    "--live here": in_a_browser,
    "/dev/ttyUSB0": on_an_emulated_line,
    "dask://scheduler:8786": on_a_cluster_of_this_machine,
    "sweep million.toml": with_fewer_rooms,
    "sweep dock.toml": with_fewer_rooms,
    "pip install ": with_known_extras,
    "make ": of_a_recipe,
}


def substitute(line):
    """The substitute for a line, or `None` if the line runs as written."""
    return next((run for text, run in SUBSTITUTES.items() if text in line), None)
