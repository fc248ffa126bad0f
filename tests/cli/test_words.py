"""Command lines accept numbers with units, and answer a wrong word in one line with the remedy."""

import math
import shlex
from pathlib import Path

import pytest

from jaxcell import bundled
from jaxcell.cli import main
from jaxcell.cli.app import read


@pytest.mark.parametrize(
    ("line", "option", "meant"),
    [
        ("groups @lab_a --bounce 45", "bounce", (45.0,)),
        ("groups @lab_a --bounce 45deg 90° 0.7853981633974483rad", "bounce", (45.0, 90.0, 45.0)),
        ("groups @lab_a --bounce 45,90", "bounce", (45.0, 90.0)),
        ("groups @lab_a --bounce=-45", "bounce", (-45.0,)),
        ("groups @lab_a --bounce -45", "bounce", (-45.0,)),
        ("groups --bounce 45 @lab_a", "bounce", (45.0,)),
        ("groups --bounce 45 @lab_a", "map", bundled("lab_a")),
        ("groups @lab_a --bounce 45 deg 90 °", "bounce", (45.0, 90.0)),
        ("groups @lab_a --bounce 45 90 --cell 0.5 m", "cell", 0.5),
        ("drift --duration 2 h @gyres", "duration", 7200.0),
        ("drift @gyres --bounds=-118.1,33.4,-118,33.5", "bounds", (-118.1, 33.4, -118.0, 33.5)),
        ("groups --cell 50cm @lab_a --bounce 45", "cell", 0.5),
        ("groups @lab_a --bounce 45 --cell .5m", "cell", 0.5),
        ("groups @lab_a --bounce 45 --robot_radius 57mm", "robot_radius", 0.057),
        ("groups @lab_a --bounce 45 --cell 0.01km", "cell", 10.0),
        ("cover @lab_a --bounce 45 --errors turn=1 --reliability 80%", "reliability", 0.8),
        ("drift @gyres --windage 2%", "windage", 0.02),
        ("drift @gyres --duration 2h", "duration", 7200.0),
        ("drift @gyres --duration 1.5min", "duration", 90.0),
        ("drift @gyres --after 5d", "after", 432_000.0),
        ("drift @gyres --start -118.01,33.5", "start", "-118.01,33.5"),
        ("drift a.nc --seed 3 b.nc", "file", (Path("a.nc"), Path("b.nc"))),
        ("drift @gyres --bounds -118.1 33.4 -118 33.5", "bounds", (-118.1, 33.4, -118.0, 33.5)),
        ("drifters @drifters --lag 12h", "lag", 0.5),
        ("patrol graph --emphasis 2 5 @eight", "emphasis", ("2", "5")),
        ("patrol map @lab_a --robots auto --capture 50%", "robots", "auto"),
        ("patrol map @lab_a --robots 3", "robots", 3),
        ("sweep @rooms --timeout 2min", "timeout", 120.0),
        ("patrol graph @eight --attack-time 1.5 min --speed 1 m/s", "attack_time", 90),
        ("patrol graph @eight --attack-time 90 --robots 2.0", "attack_time", 90),
        ("patrol graph @eight --speed 3.6km/h --time-unit 0.5s", "speed", 1.0),
        ("patrol graph @eight --speed 120cm/s", "speed", 1.2),
        ("drift @gyres --diffusivity 10m2/s", "diffusivity", 10.0),
        ("drift @gyres --bounds=-118.1° 33.4deg -118 33.5", "bounds", (-118.1, 33.4, -118, 33.5)),
        ("robot run plan.json --speed 20cm/s", "speed", 0.2),
    ],
)
def test_numbers_may_have_units_and_words_any_order(line, option, meant):
    _, command = read(shlex.split(line))
    assert getattr(command, option) == meant


def test_a_number_without_a_unit_is_read_as_python_reads_it():
    _, command = read(["groups", "@lab_a", "--bounce", "1e-3", "nan", "1_0"])
    assert command.bounce[::2] == (0.001, 10.0)
    assert math.isnan(command.bounce[1])


REFUSALS = """
groups @lab_a --bounce abc
    --bounce: expected degrees such as 45 or 45deg, got 'abc'
groups @lab_a --bounce 45 90m
    --bounce: expected degrees such as 45 or 45deg, got '90m'
groups --bounce abc @lab_a
    --bounce: expected degrees such as 45 or 45deg, got 'abc'
groups --bounce @lab_a
    --bounce: expected degrees such as 45 or 45deg, got '@lab_a'
groups @lab_a --bonce 45
    there is no option --bonce; did you mean --bounce?
patrol graph @eight --attack-time 90s
    --attack-time: '90s' may have a unit only with --speed
patrol graph @eight --speed 1m
    --speed: expected metres per second such as 0.5, 0.5m/s or 2km/h, got '1m'
localize @lab_a --bounce 45 --errors slip=2%
    there is no option --errors; try localize anywhere or localize slip
groups --bonce 45
    there is no option --bonce; did you mean --bounce?
groups @lab_a --colour red
    there is no option --colour; did you mean --collision?
groups @lab_a --xyzzy
    there is no option --xyzzy; jaxcell groups --help lists the options
groups @lab_a -b 45
    there is no option -b; did you mean --bounce?
groups @lab_a 45
    unexpected word '45'; did you mean --bounce 45?
groups @lab_a bounce 45
    unexpected word 'bounce'; did you mean --bounce?
groups @lab_a --bounce 45 deg 90 kg
    --bounce: expected degrees such as 45 or 45deg, got 'kg'
groups @lab_a --bounce 45,
    --bounce: expected a value, got an empty text
groups @lab_a --bounce 45 --cell 1 kg
    unexpected word 'kg'; jaxcell groups --help lists the options
groups
    missing MAP, --bounce; for example: jaxcell groups @lab_a --bounce 45 90 135
groups @lab_a
    missing --bounce; for example: jaxcell groups @lab_a --bounce 45 90 135
groups --bounce 45
    missing MAP; for example: jaxcell groups @lab_a --bounce 45 90 135
groups lab_a
    lab_a: there is no such file; did you mean @lab_a?
groups lab_a.json --bounce 45
    lab_a.json: there is no such file; did you mean @lab_a?
groups empty.json --bounce 45
    empty.json: the file is empty; save or copy it again
groups rooms --bounce 45
    rooms: expected a map file, got a directory; name a file in it
groups hal.txt --bounce 45
    hal.txt: there is no such file; did you mean hall.txt?
groups @LAB_A --bounce 45
    @LAB_A: not among the bundled data of jaxcell; did you mean @lab_a?
groups @xyzzyxyzzy --bounce 45
    @xyzzyxyzzy: not among the bundled data of jaxcell; `jaxcell maps` lists their names
groups @lab_a --bounce 45 --bounce 90
    --bounce: it is given twice
groups @lab_a --bounce 45 --verify=yes
    --verify: it takes no value, got 'yes'
groups @lab_a --bounce 45 --cell
    --cell: expected metres such as 0.5, 0.5m or 50cm, got nothing
groups @lab_a --bounce 45 --cell --verify
    --cell: expected metres such as 0.5, 0.5m or 50cm, got nothing
groups @lab_a --bounce 45 --cell=
    --cell: expected a value, got an empty text
groups @lab_a --bounce 45 --out ''
    --out: expected a value, got an empty text
groups '' --bounce 45
    MAP: expected a value, got an empty text
groups @lab_a --bounce 45 --collision sweep
    --collision: expected swept or endpoint, got 'sweep'; did you mean swept?
groups @lab_a --bounce 45 --directions 8.5
    --directions: expected a whole number such as 3, got '8.5'
cover @lab_a --bounce 45 --errors turn=1 --reliability often
    --reliability: expected a number from 0 to 1, or a percentage such as 2%, got 'often'
drift @gyres --bounds 1 2 3
    --bounds: expected 4 values, got 3
robot replay run.json
    run.json: there is no such file
drift @gyres --duration soon
    --duration: expected seconds such as 90, 90s, 1.5min or 2h, got 'soon'
drift @drifters
    @drifters: it holds trajectories; give it to drifters
drift @eight
    @eight: it holds a graph; give it to patrol graph or patrol guard
groups @gyres --bounce 45
    @gyres: it holds currents; give it to drift, release or deploy
patrol map @eight
    @eight: it holds a graph; give it to patrol graph or patrol guard
patrol map @lab_a --robots two
    --robots: expected a whole number such as 3 or auto, got 'two'
sweep status @rooms
    @rooms: it holds the specification of a sweep; give it to sweep
sweep @eight
    @eight: it holds a graph; give it to patrol graph or patrol guard
"""
ROWS = REFUSALS.strip().splitlines()
PAIRS = [(line, error.strip()) for line, error in zip(ROWS[::2], ROWS[1::2], strict=True)]


@pytest.mark.parametrize(("line", "expected"), PAIRS, ids=ROWS[::2])
def test_a_wrong_word_is_answered_in_one_line(line, expected, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxcell.cli.terminal.FIRST_LINE", 3600.0)
    (tmp_path / "hall.txt").write_text("...\n")
    (tmp_path / "empty.json").touch()
    (tmp_path / "rooms").mkdir()
    words = shlex.split(line)
    assert main(words) == 2
    name = " ".join(words[: 1 + (words[1:2] in (["graph"], ["map"], ["replay"], ["status"]))])
    assert capsys.readouterr() == ("", f"jaxcell {name}: {expected}\n")


@pytest.mark.parametrize("command", ["patrol graph", "drift", "robot replay", "sweep"])
def test_a_map_for_another_command_is_named_with_the_commands_that_take_it(command, capsys):
    assert main([*command.split(), "@lab_a"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxcell {command}: @lab_a: it holds a map; give it to ")
    assert "groups" in error
    assert "patrol map" in error
