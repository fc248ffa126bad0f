"""Commands refuse bad input in one line that names the option or the file, with status 2.

Limits of single options, and options without effect, are tested for all studies at once in
`tests/study/test_every_study.py`.
"""

import json
import re
import shlex

import numpy as np
import pytest

from jaxcell.cli import main


FILES = {
    "apart.adjlist": "a b\nc d\n",
    "deep.gml": "graph [" + "node [ a [" * 3000,
    "apart.txt": "; cell 1\n...#...\n...#...\n",
    "hall.txt": "; cell 1\n............\n" + "....#.......\n" * 3 + "............\n",
    "number.py": "System = 3",
    "path.adjlist": "a b\nb c\n",
}
# A command, and its error after the name of the command, in which three dots stand for any text.
REFUSALS = """
cover @lab_a --bounce 45 --errors turn=20 --reliability 0.8 --directions 8
    --errors: 20 deg is not a whole number of the 8 directions, ...; --directions 72 would do
groups @lab_a --bounce
    --bounce: expected at least one value, got none
groups @lab_a --bounce 45 --cell 50
    --cell: no cell of side 50 m has its centre in the free space
groups @lab_z --bounce 45
    @lab_z: not among the bundled data of jaxcell; did you mean ...
groups @random --bounce 45
    @random: it holds a graph; give it to patrol graph or patrol guard
localize @lab_a --bounce
    --bounce: expected at least one value, got none
localize @lab_a
    missing --bounce; for example: jaxcell localize @lab_a --bounce 135 --out runs/lab
localize @lab_a --bounce nan
    --bounce: nan deg is not finite; expected an angle such as 45 deg
localize @lab_a --bounce 45 --start 2,2,0
    --start '2,2,0': the point (2, 2) lies in an obstacle or too near a wall
localize @lab_a --bounce 45 --start 99,2,0
    --start '99,2,0': the point (99, 2) is off the map
localize @lab_a --bounce 45 --start 1,2
    --start '1,2': expected "x,y,heading" in metres and degrees, or a cell number
localize @lab_a --bounce 45 --start 0.5,0.5,10
    --start '0.5,0.5,10': expected a heading that is one of the 8 directions, a multiple of 45 ...
localize @lab_a --bounce 45 --start 152
    --start '152': cell 152 does not exist; cells are 0 to 151
localize slip @lab_a --bounce 45 405 --errors slip=0.02
    --bounce: 45 and 405 deg are the same turn; give it once
localize anywhere @lab_a --bounce 45 --errors speed=1
    --errors 'speed=1': expected NAME=VALUE, a name of run, distance, late, turn, ...
localize anywhere @lab_a --bounce 45 --errors run=x
    --errors 'run=x': expected a number from 0 to 1, or a percentage such as 2%, got 'x'
localize anywhere @lab_a --bounce 100
    angle: expected a multiple of 45 degrees, the width of a slice of headings, got 100 degrees
localize anywhere @lab_a --bounce 45 --errors bump_turn=200deg
    --errors: bump_turn: expected less than 45 degrees, got 200 degrees
localize anywhere @lab_a --bounce 45 --start 2,2,0
    --start '2,2,0': (2 m, 2 m) is not in the free space
navigate anywhere @lab_a --bounce 90 --goal 2,2 --robots 100000000
    --goal '2,2': the point (2, 2) lies in an obstacle or too near a wall
navigate anywhere @lab_a --bounce 90 --goal 3
    --goal '3': expected "x,y" or "x,y,radius" in metres
team @lab_a --robots 20 --bounce 135
    --robots 20: expected from 1 to 19, one for each position
team @lab_a --robots 3 --start 0 1 --bounce 135
    --robots 3: --start names 2; give one of the two
drift @gyres --depths 0 --start here
    --start 'here': expected "lon,lat" in degrees
drift @gyres --depths 0 --start 5,6
    --start 5,6: place (5, 6) is off the grid...
drift @gyres --depths 0 --goal=-118,33.5
    --goal '-118,33.5': expected "lon,lat,depth" in degrees and metres
drift @gyres --depths 0 --goal=-118,33.5,3
    --goal -118,33.5,3: expected one of the depths 0 m, got 3
drift @gyres --depths 0 --nearly-closed 600
    --nearly-closed: expected at most 538, the cells of a layer, got 600
drifters @drifters --after 100000
    --after: expected more than 0 and at most 50000 days, 10,000 times the lag, got 100000
drifters @drifters --cell 2 --nearly-closed 9999
    --nearly-closed: expected at most 72, the number of cells, got 9999
drifters @gyres
    @gyres: it holds currents; give it to drift, release or deploy
release @gyres --start=-117.93,33.5 --until 0.5 --windage 3%
    @gyres: wind: the file has no wind for windage; expected ...
drift @gyres --depths 0 --regions @lab_a
    --regions @lab_a: it holds a map; expected a GeoJSON FeatureCollection of ...
dynamics lorenz63
    SYSTEM: expected FILE.py:NAME or one of duffing, ...; did you mean lorenz84?
dynamics number.py:System
    SYSTEM: number.py:System: expected a jaxcell.dynamics.System, got 3
dynamics number.py:Systm
    SYSTEM: number.py:Systm: module 'number' has no attribute 'Systm'; it has ...
dynamics henon --params aa=1
    --params: expected NAME=NUMBER with a name among a, b, got 'aa=1'; did you mean a?
dynamics henon --params c=1
    --params: expected NAME=NUMBER with a name among a, b, got 'c=1'
dynamics henon --cells 0
    --cells: axis 0 has 0, expected at least 1
patrol graph @eight --strategy capture
    --attack-time: it is needed with --strategy capture and without --attack-times
patrol graph @eight --emphasis 2
    --emphasis: expected two or more vertices, got one
patrol graph @eight --emphasis 2 5 2
    --emphasis: vertex '2' comes twice
patrol graph @eight --base 9
    --base: there is no vertex '9'; there are 1, 2, 3, 4, 5, 6, 7, 8
patrol graph @eight --emphasis 2 55
    --emphasis: there is no vertex '55'; did you mean 5?
patrol graph @eight --charger 2
    --every: it is needed with --charger
patrol graph @eight --charger 2 --every 2
    --every: expected at least 4 steps, to the farthest vertex and back, got 2
patrol graph @eight --robots 2 --division shared --emphasis 1 2
    --division: a part of the graph may lack vertices of --emphasis
patrol graph apart.adjlist
    apart.adjlist: no walk leads from vertex 'a' to 'c'; expected a connected graph
patrol graph deep.gml
    deep.gml: not .gml that networkx reads: maximum recursion depth exceeded...
patrol graph path.adjlist --speed 1
    --speed: edges of path.adjlist have no lengths, and its vertices no positions
patrol map @lab_a --robots auto
    --capture: it is needed with --robots auto
patrol map @lab_a --robots 20
    --robots: 20 robots are more than the 19 cells of @lab_a
patrol map @lab_a --target 2,2
    --target '2,2': the point (2, 2) lies in an obstacle or too near a wall
patrol map @lab_a --target x
    --target 'x': expected "x,y" in metres
patrol map @lab_a --range 0.3 --sight cell
    --range: with 0.3 m no robot sees a cell that is not always watched...
patrol map @lab_a --range 3 --base auto --lost 5
    --lost: there is no robot 5; robots are 0 to 1
patrol map hall.txt --range 2.5 --base 8.5,2.5 --base-range 2 --target 8.5,1.5
    --target '8.5,1.5': the base station always sees it...
patrol map @lab_a --range 3 --robots 1 --base auto --lost 0
    --lost: robot 0 is the only one; none would be left to patrol
patrol map @lab_a --attack-times
    --attack-times: expected at least one
patrol map apart.txt --piece all
    apart.txt: its cells are in separate pieces; no way leads from (0.5, 0.5) to (4.5, 0.5)
run json:dumps
    json:dumps: expected a class that derives from jaxcell.study.Study, ...
run stones
    stones: expected FILE.py:CLASS or MODULE:CLASS
robot run a.jxf
    expected one of --port, --ros or --simulate
robot run a.jxf --simulate @lab_a --physics --errors slip=10%
    --errors: it has an effect only with --simulate and without --physics
robot run a.jxf --ros base --steps clock
    --steps: it has an effect only without --ros
robot run a.jxf --ros base --port x
    --ros: it has an effect only without --port
robot run a.jxf --port x --remap a
    --remap: it has an effect only with --ros
robot run a.jxf --simulate @lab_a --speed 0.7
    --speed: expected more than 0 and at most 0.5 m/s, got 0.7
robot run filter.jxf --simulate @lab_a
    ...because the steps of filter.jxf differ between directions...
robot run filter.jxf --simulate @lab_a --heading 30
    --heading 30: expected a multiple of the 45 degrees...
robot run filter.jxf --simulate @lab_a --heading inf
    --heading inf: expected a multiple of the 45 degrees...
robot run filter.jxf --simulate @lab_a --heading 0 --start 0.5,9,0
    --start '0.5,9,0'...
robot run filter.jxf --simulate @lab_a --heading 0 --intruder 1,1
    --intruder: it has an effect only for a patrol...
robot run filter.jxf --simulate @lab_a --robot 0
    ...the task is for one robot...
robot run plan.json --simulate @lab_a --heading 45 --until cycle
    --until: it has an effect only for a filter...
robot run plans.nc --simulate @lab_a
    ...a robot does not read NetCDF...
robot run patrol.json --simulate @lab_b --intruder x
    --intruder 'x': expected...
robot run patrol.json --simulate @lab_b --camera . --intruder 1,1
    --camera: it has an effect only without --intruder
robot sketch
    expected one of FILE or --bounce
robot sketch plan.json
    plan.json: expected a filter...
robot sketch --bounce 90
    --step: it is needed with --bounce
robot sketch --bounce 90 --step 0.2 --out a.txt
    --out a.txt: expected a name that ends in .ino
sweep @rooms --anyway
    --anyway: it has an effect only with --resume
sweep @rooms --netcdf --shard 1/2
    --netcdf: it has an effect only without --shard
sweep view @rooms --out a.nc
    --out a.nc: expected the name of a recording, FILE.rrd
export filter.jxf f.jff --smallest
    ...expected .dot, .json or .h with --smallest
export filter.jxf f.h --smallest --output action
    ...expected color, count, cells or localized...
export filter.jxf f.h --smallest --minimal
    --smallest: it has an effect only without --minimal
export a.jxf a.exe
    a.exe: expected a suffix among .dot, .jff, .json, .h
"""
GROUPS = {"patrol", "robot"}
ROWS = REFUSALS.strip().splitlines()
PAIRS = [(line, error.strip()) for line, error in zip(ROWS[::2], ROWS[1::2], strict=True)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the files of the commands, and with tasks of robots."""
    from robot_files import SPEC, save_filter
    from wheels import map_cells

    from jaxcell.robot.tasks.patrol_task import save_patrols

    folder = tmp_path_factory.mktemp("files")
    plan = {**SPEC, "found": True, "start": 20, "actions_deg": [0]}
    for name, text in {**FILES, "plan.json": json.dumps(plan)}.items():
        (folder / name).write_text(text)
    save_filter(folder)
    cells = map_cells("lab_b.json")
    walk = np.arange(cells.positions)[None], np.ones((1, cells.positions))
    save_patrols(folder / "patrol.json", cells, [walk], [0], 1.6)
    return folder


@pytest.mark.parametrize(("line", "expected"), PAIRS, ids=ROWS[::2])
def test_bad_input_is_refused_in_one_line(line, expected, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(shlex.split(line)) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (error,) = printed.err.splitlines()
    wanted = re.escape(expected).replace(re.escape("..."), ".*")
    name = " ".join(line.split()[: 1 + (line.split()[0] in GROUPS)])
    assert re.fullmatch(rf"jaxcell {name}(?: \S+)?: {wanted}", error), error
