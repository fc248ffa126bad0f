from shlex import quote

import pytest
from rerun.chunk import RrdReader

import jaxcell.cli.sweep.view
from jaxcell.cli import main
from jaxcell.cli.sweep.view import detailed_study, member_detail, parameters, selected
from jaxcell.sweep import Spec, open_sweep, run_sweep


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    monkeypatch.setattr(jaxcell.cli.sweep.view, "has_display", lambda: False)


@pytest.fixture
def ran(tmp_path):
    """Runs a sweep, and gives its folder."""

    def run(text, head="", **options):
        path = tmp_path / "spec.toml"
        path.write_text(f"{head}\nseed = 3\n{text}\n")
        run_sweep(Spec.load(path), tmp_path / "out", **options)
        return tmp_path / "out"

    return run


def entities(path):
    return {chunk.entity_path for chunk in RrdReader(path).stream().to_chunks()}


def detail(folder, *select):
    """The detail of a member, its numbers in the sweep, and the entities of its recording."""
    spec = Spec.load(folder / "spec.toml")
    places = selected(spec, select)
    out = folder / "member.rrd"
    found = member_detail(detailed_study(spec.task), parameters(spec, places), spec.seed, out)
    assert not [*folder.glob(".member-*")]
    with open_sweep(folder) as dataset:
        member = {name: one.item() for name, one in dataset.isel(places).load().data_vars.items()}
    assert member.pop("status") == 1
    return found, member, entities(out)


def test_sweep_view_writes_an_overview_and_a_member(ran, capsys):
    fixed = "[fixed]\ncolumns = 9\nrows = 7\nobstacles = 2\ndirections = 8"
    folder = ran(f'task = "rooms"\n{fixed}\n[grid]\nroom = {{count = 3}}\nbounce = [45, 90]')
    assert main(["sweep", "view", str(folder)]) == 0
    printed = capsys.readouterr()
    assert f"view --web {quote(str(folder / 'overview.rrd'))}" in printed.err
    assert "/series/count/median" in entities(folder / "overview.rrd")

    assert main(["sweep", "view", str(folder), "--select", "bounce=90", "room=2"]) == 0
    printed = capsys.readouterr()
    out = folder / "members" / "room=2,bounce=90.rrd"
    assert f"view --web {quote(str(out))}" in printed.err
    assert "In the sweep: room=2,bounce=90" in printed.out
    assert "/map/grid/bounce_90/groups" in entities(out)

    found, member, logged = detail(folder, "room=2", "bounce=45")
    assert member.pop("filter_states") == found["groups"][0].pop("filter_states") > 0
    assert found["positions"] == member.pop("positions")
    assert found["groups"] == [{"bounce_deg": 45, **member}]
    other = folder / "other.rrd"
    command = ["sweep", "view", str(folder), "--select", "bounce=45", "room=2"]
    assert main([*command, "--out", str(other)]) == 0
    assert entities(other) == logged


def test_a_viewer_opens_if_there_is_a_display(ran, monkeypatch):
    opened = []
    monkeypatch.setattr(jaxcell.cli.sweep.view, "has_display", lambda: True)
    monkeypatch.setattr("jaxcell.cli.view.has_display", lambda: True)
    monkeypatch.setattr("subprocess.call", lambda command: opened.append(command[-1]) or 0)
    folder = ran('task = "sweep_stub:stub"\n[grid]\nx = {count = 4}')
    assert main(["sweep", "view", str(folder)]) == 0
    assert opened == [str(folder / "overview.rrd")]


@pytest.mark.parametrize("directions", ["directions = 8", ""])
def test_a_member_in_detail_equals_its_numbers_in_the_sweep(ran, directions):
    fixed = f'map = "@lab_a"\nbounce = [45, 135]\nerrors_turn = 45\n{directions}'
    folder = ran(
        f'task = "cover"\n[fixed]\n{fixed}\n[random]\nsamples = 2\nreliability.uniform = [0.5, 0.9]'
    )
    found, member, _ = detail(folder, "sample=1")
    assert found["directions"] == (8 if directions else 360)
    assert member["groups_in_all"] == sum(x["persistent_groups"] for x in found["policies"])
    for name in ("distance", "total_variation", "positions_visited"):
        assert member[name] == pytest.approx(found[name], rel=1e-9)


def test_members_are_selected_by_their_values(tmp_path):
    path = tmp_path / "spec.toml"
    path.write_text(
        'task = "groups"\n[fixed]\ndirections = 8\n[grid]\nmap = ["a/b.json", "c.json"]\n'
        "cell = {start = 0, stop = 1, num = 8}\none = [5]\n[random]\nsamples = 4\n"
        "bounce.uniform = [0, 360]\n"
    )
    spec = Spec.load(path)
    places = selected(spec, ["sample=2", "map=c.json", "cell=0.285714"])
    assert places == {"map": 1, "cell": 2, "one": 0, "sample": 2}
    bounce = next(one.values[2] for one in spec.parameters if one.name == "bounce")
    expected = {"directions": 8, "map": "c.json", "cell": 2 / 7, "one": 5, "bounce": bounce}
    assert parameters(spec, places) == pytest.approx(expected)
    for select, message in {
        "map=d.json": "--select map=d.json: there is no such value; there are a/b.json, c.json",
        "cell=0.3": r"there are 0.0, .*, \.\.\., 1.0; the nearest is 0.2857",
        "cell=x": "cell=x: there is no such value",
        "cell=nan": "cell=nan: there is no such value",
        "sample=4": r"there are 0, 1, 2, 3; the nearest is 3",
        "bounce=3": "--select bounce=3: expected NAME=VALUE with a name among map, cell, one, sam",
        "map": "--select map: expected NAME=VALUE",
        "one=5": "--select: expected a value for each of map, cell, one, sample; map is missing",
    }.items():
        with pytest.raises(ValueError, match=message):
            selected(spec, [select])
    with pytest.raises(ValueError, match=r"map=c\.json: map comes twice"):
        selected(spec, ["map=c.json", "map=c.json"])


def test_members_without_a_result_or_a_study_are_refused(ran, tmp_path, capsys, monkeypatch):
    folder = ran(
        'task = "sweep_stub:stub"\n[fixed]\nfail = 2\n[grid]\nx = {count = 6}', head="chunk = 2"
    )
    monkeypatch.chdir(tmp_path)
    view = ["sweep", "view", str(folder)]
    assert main([*view, "--select", "x=0"]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert "the task 'sweep_stub:stub' has no detail to show; expected a study of yours" in printed
    monkeypatch.setattr("jaxcell.cli.sweep.view.detailed_study", lambda task: None)
    assert main([*view, "--select", "x=2"]) == 1
    assert "The member x=2 has no result: RuntimeError: x is 2" in capsys.readouterr().err
    assert main([*view, "--out", "some.txt"]) == 2
    assert "--out some.txt: expected the name of a recording" in capsys.readouterr().err
    assert main(["sweep", "view", str(tmp_path / "none")]) == 2
    assert "expected the folder of a sweep" in capsys.readouterr().err


def test_a_member_that_is_not_computed_yet(ran, capsys):
    folder = ran(
        'task = "rooms"\nchunk = 1\n[fixed]\ndirections = 4\nbounce = 90\ncolumns = 5\n'
        "rows = 5\nobstacles = 0\n[grid]\nroom = {count = 2}",
        chunks=[0],
    )
    assert main(["sweep", "view", str(folder), "--select", "room=1"]) == 1
    assert "The member room=1 has no result: it is not computed yet" in capsys.readouterr().err
