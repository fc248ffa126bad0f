"""The library works without the modules of its extras, and names the extra that is missing."""

import re
import tomllib
from pathlib import Path

import pytest
from helpers import python


PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
# Names of modules that are not those of their packages.
MODULES = {
    "distributed": "distributed dask",
    "mujoco-core": "mujoco",
    "opencv-python-headless": "cv2",
    "pillow": "PIL",
    "pyserial": "serial",
    "pyshp": "shapefile",
    "python-sat": "pysat",
    "pyyaml": "yaml",
    "rerun-sdk": "rerun",
}
WITHOUT = """
import sys


class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[1].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Blocked())
exec(sys.argv[2])
"""
ARRAYS = """
import math

import jax
import jax.numpy as jnp

from jaxcell import automata, bounce, bundled, dynamics, examples, mapping, markov, optimize, space

P = [[0.5, 0.5, 0.0], [0.25, 0.5, 0.25], [0.0, 0.5, 0.5]]
print(markov.limiting_distribution(P).value.round(6).tolist())
print(markov.hitting_times(P, 2).value.round(6).tolist())
cells = space.CellSpace.load(bundled("lab_a"), cell=1.0, directions=8)
bounces = bounce.bounce_map(examples.corridor(directions=4), math.pi)
print(bounce.localize(bounces, bounce.localization_filter(bounces), start=1).candidates.size > 0)
print(jax.jit(jax.vmap(lambda angle: bounce.bounce_map(cells, angle).image))(jnp.ones(3)).shape)
"""
TRIED = """\
try:
    {}
except ModuleNotFoundError as error:
    print(error)
else:
    print("no error")
"""


def modules(extra):
    names = [re.match(r"[\w-]+", requirement).group().lower() for requirement in EXTRAS[extra]]
    return [module for name in names for module in MODULES.get(name, name).split()]


def without(blocked, program):
    return python("-c", WITHOUT, ",".join(blocked), program)[0]


def test_arrays_need_no_extra():
    every = [module for extra in EXTRAS for module in modules(extra) if module != "jaxcell"]
    found = without(every, ARRAYS).splitlines()
    assert found == ["[0.25, 0.5, 0.25]", "[8.0, 6.0, 0.0]", "True", "(3, 152)"]


@pytest.mark.parametrize(
    ("extra", "blocked", "statement"),
    [
        ("ocean", "xarray", "from jaxcell.drift import open_currents"),
        ("patrol", "networkx", "from jaxcell.patrol import maximin_capture"),
        ("patrol", "optax", "from jaxcell.patrol.walks import maximum_entropy_rate"),
        ("robot", "serial", "from jaxcell import robot"),
        ("robot", "yaml", "from jaxcell.space import Workspace; Workspace.load('room.yaml')"),
        ("app", "tyro", "from jaxcell import study"),
        ("verify", "cvxpy", "from jaxcell.optimize.conic import *; least_resistance(0, 0)"),
        ("view", "rerun", "from jaxcell.record import log_sweep"),
    ],
)
def test_a_missing_extra_is_one_sentence(extra, blocked, statement, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.yaml").write_text("image: room.pgm\n")
    said = without([blocked], TRIED.format(statement))
    assert said.count("\n") == 1
    assert f"install it with: pip install 'jaxcell[{extra}]'" in said


def test_a_command_without_its_extra_is_refused_in_a_line():
    out, errors = python("-c", WITHOUT, "tyro", "from jaxcell.cli import main; print(main(['-V']))")
    assert out == "2\n"
    advice = "install it with: pip install 'jaxcell[app]'"
    assert errors == f"jaxcell: commands and studies need tyro; {advice}\n"


def test_all_extras_are_in_one():
    assert "jaxcell[app," in EXTRAS["all"][0]
    named = set(re.findall(r"\w+", f"{EXTRAS['app']} {EXTRAS['all']}")) - {"jaxcell", "all", "app"}
    assert named == set(EXTRAS) - {"all", "app"}
