"""Properties of all recordings, read back from one recording of each family."""

import fnmatch
import functools
import math
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from recordings import Recording, columns, packed
from wheels import bounce_filter, map_cells

from jaxcell.cli import main
from jaxcell.record import RecordedRobot, RobotRecording, log_sweep
from jaxcell.record.canvas import palette
from jaxcell.record.canvas.palette import robot_color


DATA = Path(__file__).parents[2] / "data"
ROOM = "; cell 1\n#######\n#..#..#\n#.....#\n#.....#\n#######\n"
COMMANDS = {
    "localization": "localize {data}/maps/lab_a.json --bounce 135 --collision endpoint",
    "policy": "localize {room} --directions 8 --bounce 45 135",
    "slip": "localize slip {room} --directions 8 --bounce 45 135 --errors slip=0.02 --start 100",
    "groups": "groups {room} --directions 8 --bounce 45 90",
    "anywhere": "localize anywhere {room} --bounce 135 --robots 3 --bumps 6",
    "home": "navigate anywhere {room} --bounce 45 135 --goal 1.5,1.5 --heading unknown "
    "--errors turn=1 --measured --robots 3 --slices 72",
    "navigation": "navigate {room} --directions 8 --bounce 45 90 135 "
    "--start 1.5,1.5,0 --goal 5.5,2.5,0",
    "no_plan": "navigate {room} --directions 8 --bounce 180 --start 1.5,1.5,0 --goal 5.5,2.5,0",
    "coverage": "cover {room} --directions 8 --bounce 45 90 --errors turn=45 --reliability 0.8",
    "team": "team {room} --directions 8 --robots 2 --bounce 135",
    "patrol": "patrol graph {data}/graphs/eight.json --robots 2 --game",
    "charger": "patrol graph {data}/graphs/eight.json --charger 3 --every 8 --base 2",
    "patrol_map": "patrol map {room} --robots 2 --range 3 --attack-times 4 --runs 200",
    "drift": "drift {sea} --bounds -118.1 33.44 -118 33.54 --duration 3400 --depths 5 "
    "--start=-118.01,33.5",
}
FAMILIES = [*COMMANDS, "robot", "sweep"]
MAX_WORDS = 60
TIMELINES = "bump step direction cover observation seconds second minute date hour"
# Components with content, without those of style.
CONTENT = """
Arrows2D:vectors Arrows3D:vectors Boxes2D:half_sizes GraphNodes:node_ids LineStrips2D:strips
Mesh3D:vertex_positions Points2D:positions Points3D:positions Scalars:scalars
SegmentationImage:buffer TextDocument:text TextLog:text"""
# A view needs more than these, which every map has.
GROUND = {"/map/walls", "/map/grid/free"}
THINGS = {
    "localization": {"/map/belief": palette.BELIEF, "/map/candidates": palette.KNOWN},
    "home": {"/map/stretches": palette.BELIEF, "/map/goal": palette.GOAL},
    "navigation": {"/map/start/frame": palette.START, "/map/goal/frame": palette.GOAL},
    "patrol": {f"/graph/patrollers/{i}/here": robot_color(i)[1] for i in range(2)},
    "patrol_map": {
        **{f"/map/sight/{i}": robot_color(i)[1] for i in range(2)},
        "/map/target": palette.TARGET,
        "/map/target_cell": palette.TARGET,
        "/map/worst_capture/frame": palette.TARGET,
    },
    "drift": {"/map/start": palette.START},
    "robot": {"/map/robots/robot": palette.ROBOT, "/map/belief": palette.BELIEF},
}
WITH_ROBOT = ("localization", "policy", "slip", "anywhere", "home", "navigation")
CLASSES = {
    "obstacle": palette.OBSTACLE,
    "free": palette.FREE,
    "too near a wall": palette.MARGIN,
    "not free": palette.CLEAR,
}


class Look(Recording):
    """A recording with its blueprint: the queries of its views, and its data."""

    def __init__(self, path):
        super().__init__(path)
        self.folder = path.parent
        self.fixed, self.times = {}, {}
        for chunk in self.chunks:
            for name, values in columns(chunk):
                if chunk.is_static:
                    self.fixed[chunk.entity_path, name] = values[0]
                if name not in CONTENT.split():
                    continue
                for timeline in chunk.timeline_names or [None]:
                    times = [0] if timeline is None else chunk.to_record_batch().column(timeline)
                    times = np.asarray(times).astype(np.int64)
                    drawn = times[[bool(value) for value in values]]
                    known = self.times.setdefault((chunk.entity_path, timeline), [])
                    known.extend(drawn.tolist())
        self.timeline = self.blueprint["/time_panel"]["TimePanelBlueprint:timeline"][0]

    def views(self):
        """The kind, the name and the entities of each view."""
        for path, values in self.blueprint.items():
            if "ViewBlueprint:class_identifier" not in values:
                continue
            origin = "/" + values["ViewBlueprint:space_origin"][0].strip("/")
            query = self.blueprint[f"{path}/ViewContents"]["ViewContents:query"]
            wanted = [line.removeprefix("+").strip() for line in query]
            wanted = [line.replace("$origin", origin).replace("//", "/") for line in wanted]
            name = values["ViewBlueprint:display_name"][0]
            yield values["ViewBlueprint:class_identifier"][0], name, wanted

    def shown(self, wanted):
        """The times, on the timeline of the blueprint, of data of the entities of a view."""
        shown = {}
        for (entity, timeline), times in self.times.items():
            queried = any(matches(entity, line) for line in wanted)
            if queried and timeline in (None, self.timeline) and times:
                shown.setdefault(entity, []).extend(times if timeline else [-math.inf])
        return shown


def matches(entity, line):
    if line.endswith("/**"):
        return fnmatch.fnmatchcase(entity + "/", line[:-2] + "*")
    return entity == line


def record_robot(path):
    cells = map_cells("lab_a.json")
    filter = bounce_filter(cells, 45)
    trace = [(0.0, 1.0, 2.0, 1.5), (0.9, 1.0, 2.5, 1.5)]
    robot = RecordedRobot(start=(1.0, 2.0, 1.5), trace=trace)
    with RobotRecording(path, [robot], cells=cells, filter=filter) as recording:
        state = int(filter.run("1").states[-1])
        believed = {"state": state, "color": 1, "uncertainty": int(filter.uncertainty[state])}
        fields = {"seconds": 1.0, "observation": 1, "estimate": [0.0, 0.0, 0.0], **believed}
        recording.event("observation", fields)
        recording.event("end", {"seconds": 2.0, "result": "stopped", "reason": "a test"})


def record_sweep(path):
    status = (("x", "y"), np.ones((4, 3), np.int8))
    variables = {"status": status, "value": (("x", "y"), np.arange(12.0).reshape(4, 3))}
    log_sweep(path, xr.Dataset(variables, {"x": [0, 10, 20, 30], "y": [1, 2, 3]}))


@pytest.fixture(scope="module")
def looks(tmp_path_factory, few_drifters):
    """A function that returns the recording of a family, made at the first call."""
    out = tmp_path_factory.mktemp("looks")
    room = out / "room.txt"
    room.write_text(ROOM)
    sea = out / "sea.nc"
    with xr.open_dataset(DATA / "ocean" / "gyres.nc", decode_times=False) as whole:
        whole.isel(time=slice(4)).to_netcdf(sea)
    makers = {"robot": record_robot, "sweep": record_sweep}

    @functools.cache
    def look(family):
        if family in COMMANDS:
            places = {"data": DATA, "room": room, "sea": sea}
            words = [word.format(**places) for word in COMMANDS[family].split()]
            assert main([*words, "--out", str(out / family)]) == (family == "no_plan")
        else:
            (out / family).mkdir()
            makers[family](out / family / "run.rrd")
        return Look(next((out / family).glob("*.rrd")))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.bounce.slip.fine_cells.SAMPLES", 8)
        patch.setattr("jaxcell.record.drift.currents.DRIFTERS", 20)
        yield look


@pytest.mark.parametrize("family", FAMILIES)
def test_no_view_is_empty(looks, family):
    look = looks(family)
    views = list(look.views())
    assert len(views) > 2
    assert look.blueprint["/viewport"]["ViewportBlueprint:auto_views"] == [False]
    first = min(min(times) for (_, line), times in look.times.items() if line == look.timeline)
    for kind, name, wanted in views:
        assert name
        shown = look.shown(wanted)
        content = shown.keys() - GROUND
        assert content, (kind, name, wanted)
        # Curves and logs may begin later.
        if kind not in ("TimeSeries", "TextLog"):
            assert min(min(shown[entity]) for entity in content) <= first, (name, wanted)


@pytest.mark.parametrize("family", FAMILIES)
def test_timelines_have_known_names(looks, family):
    expected = "x y" if family == "sweep" else TIMELINES
    assert looks(family).timelines <= set(expected.split())
    assert looks(family).timeline in looks(family).timelines


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_things_have_the_same_colors(looks, family):
    look = looks(family)
    robot = {"/map/robot": palette.ROBOT} if family in WITH_ROBOT else {}
    for entity, color in (robot | THINGS.get(family, {})).items():
        (name,) = (n for e, n in look.fixed if e == entity and n.endswith(":colors"))
        assert look.fixed[entity, name] == [packed(color)], entity
    if ("/map/walls", "LineStrips2D:colors") in look.fixed:
        assert look.fixed["/map/walls", "LineStrips2D:colors"] == [packed(palette.WALL)]
    for (entity, name), value in look.fixed.items():
        if name != "AnnotationContext:context":
            continue
        for one in value[0]:
            info = one["class_description"]["info"]
            if info["label"] in CLASSES:
                assert info["color"] == packed(CLASSES[info["label"]]), (entity, info["label"])


@pytest.mark.parametrize("family", COMMANDS)
def test_no_text_has_the_folder_of_a_file(looks, family):
    look = looks(family)
    texts = [str(value) for (_, name), value in look.fixed.items() if "TextDocument" in name]
    for path in look.folder.glob("*.nc"):
        with xr.open_dataset(path) as dataset:
            texts.append(dataset.attrs["spec"])
    texts.append((look.folder / "summary.json").read_text())
    read = next(word for word in COMMANDS[family].split() if word.startswith("{"))
    name = Path(read.format(data=DATA, room="room.txt", sea="sea.nc")).name
    assert sum(name in text for text in texts) >= 3
    assert not any(str(place) in "".join(texts) for place in (DATA, look.folder.parent))


@pytest.mark.parametrize("family", FAMILIES)
def test_texts_beside_views_are_short(looks, family):
    texts = [value for (_, name), value in looks(family).fixed.items() if "TextDocument:t" in name]
    assert texts
    for (text,) in texts:
        prose = " ".join(line for line in text.splitlines() if line[:1] not in ("#", "|", "`"))
        assert len(re.findall(r"[A-Za-z0-9]\S*", prose)) <= MAX_WORDS, text


@pytest.mark.parametrize("family", FAMILIES)
def test_y_is_up(looks, family):
    look = looks(family)
    planes = {entity.split("/")[1] for entity, _ in look.times} & {"map", "graph", "odometry"}
    assert planes or family == "sweep"
    for plane in planes:
        scale = look.fixed[f"/{plane}", "Transform3D:scale"]
        np.testing.assert_array_equal(np.ravel(scale), [1, -1, 1])


def test_no_recording_is_shown_by_the_blueprint_of_another(looks, tmp_path):
    """The viewer keeps one blueprint for each application."""
    record_sweep(tmp_path / "again.rrd")
    again = Look(tmp_path / "again.rrd")
    names = [look.application for look in (*map(looks, FAMILIES), again)]
    assert len(set(names)) == len(names)
