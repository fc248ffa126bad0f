import json
import subprocess
import sys
from pathlib import Path

import pytest
import xarray as xr
from rerun.chunk import RrdReader

from jaxcell.automata import Filter
from jaxcell.cli import main


MAPS = Path(__file__).parents[2] / "data" / "maps"


def run(capsys, *args):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main([*map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


@pytest.mark.parametrize(
    ("name", "bounce", "states", "groups", "uncertainties"),
    [
        ("lab_a", 45, 129, 1, [1, 3, 4]),
        ("lab_a", 135, 124, 1, [1, 2]),
        ("lab_b", 45, 147, 1, [1, 2]),
        ("lab_b", 135, 202, 2, [1, 1]),
    ],
)
def test_tables_2_1_and_2_2(capsys, name, bounce, states, groups, uncertainties):
    args = ("--bounce", bounce, "--collision", "endpoint")
    status, found, _ = run(capsys, "localize", MAPS / f"{name}.json", *args)
    assert status == 0
    assert (found["nfa_states"], found["dfa_states"]) == (153, states)
    assert found["periodic_groups"] == groups
    assert sorted(c["cycle_uncertainty"] for c in found["cycles"]) == uncertainties
    assert found["minimal_states"] <= states
    assert found["run"]["truth_is_a_candidate"]
    assert len(found["run"]["candidates"]) in uncertainties


def test_the_robot_starts_where_told(capsys):
    args = (MAPS / "lab_a.json", "--bounce", 45, "--collision", "endpoint")
    _, by_pose, _ = run(capsys, "localize", *args, "--start", "0.5,0.5,45")
    _, by_cell, _ = run(capsys, "localize", *args, "--start", "19")
    assert by_pose["run"] == by_cell["run"]
    assert by_cell["run"]["start"] == 19
    assert by_cell["run"]["word"].count("1") == by_cell["run"]["bumps"]


def test_a_random_start_is_reproducible(capsys):
    args = (MAPS / "lab_a.json", "--bounce", 45)
    starts = [run(capsys, "localize", *args, "--seed", s)[1]["run"]["start"] for s in (1, 1, 2)]
    assert starts[0] == starts[1] != starts[2]


def test_several_angles_make_one_run(capsys):
    maps = MAPS / "lab_a.json"
    _, both, _ = run(capsys, "groups", maps, "--bounce", 45, 135, "--collision", "endpoint")
    alone = [
        run(capsys, "groups", maps, "--bounce", b, "--collision", "endpoint")[1]["groups"][0]
        for b in (45, 135)
    ]
    assert both["groups"] == alone
    assert [g["count"] for g in alone] == [1, 1]
    assert [g["largest_basin"] for g in alone] == [152, 152]


@pytest.mark.parametrize("command", ["localize", "groups"])
def test_results_are_left_to_look_at(capsys, tmp_path, command):
    args = (MAPS / "lab_b.json", "--bounce", 135, "--collision", "endpoint")
    status, found, _ = run(capsys, command, *args, "--out", tmp_path / "new" / "folder")
    assert status == 0
    names = {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    expected = {"groups.nc", "summary.json"}
    if command == "localize":
        expected |= {"localization.nc", "filter.jxf", "localization.rrd"}
    else:
        expected |= {"groups.rrd"}
    assert names == expected
    assert json.loads((tmp_path / "new" / "folder" / "summary.json").read_text()) == found


def test_results_do_not_say_where_maps_are_kept(capsys, tmp_path, monkeypatch):
    home, work = tmp_path / "home" / "me", tmp_path / "work"
    home.mkdir(parents=True)
    work.mkdir()
    (home / "lab.json").write_bytes((MAPS / "lab_a.json").read_bytes())
    monkeypatch.chdir(work)
    args = ("--bounce", "135", "--collision", "endpoint", "--out", "out")
    status, found, _ = run(capsys, "localize", home / "lab.json", *args)
    assert (status, found["map"]) == (0, "lab.json")
    told = recorded_texts("out/localization.rrd")
    assert "| map | lab.json |" in told
    for name in ("groups.nc", "localization.nc"):
        with xr.open_dataset(f"out/{name}") as dataset:
            assert '"map": "lab.json"' in dataset.attrs["spec"]
            told += str(dataset.attrs)
    told += str(Filter.load("out/filter.jxf").metadata)
    assert str(home) not in told + Path("out/summary.json").read_text()


def recorded_texts(path):
    """All that a recording says, the names that the viewer lists too."""
    reader = RrdReader(path)
    batches = [chunk.to_record_batch() for chunk in reader.stream().to_chunks()]
    return "\n".join(
        text
        for batch in batches
        for column in batch.columns
        for row in column.to_pylist()
        for text in (row if isinstance(row, list) else [row])
        if isinstance(text, str)
    )


@pytest.mark.parametrize("suffix", [".dot", ".jff", ".json", ".h"])
def test_filters_are_exported(capsys, tmp_path, suffix):
    args = (MAPS / "lab_a.json", "--bounce", 45, "--out", tmp_path)
    run(capsys, "localize", *args)
    for minimal in ([], ["--minimal"]):
        file = tmp_path / f"filter{suffix}"
        assert main(["export", str(tmp_path / "filter.jxf"), str(file), *minimal]) == 0
        assert file.stat().st_size > 100
    assert main(["export", str(tmp_path / "filter.jxf"), str(tmp_path / "filter.exe")]) == 2
    assert "expected a suffix among .dot, .jff, .json, .h" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("nowhere.json", "--bounce", 45), "nowhere.json"),
        ((MAPS / "lab_a.json", "--bounce", 50), "bounce: 50 deg is not a whole number"),
        ((MAPS / "lab_a.json", "--bounce", "nan"), "bounce: nan deg"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--cell", 0), "--cell: expected more than 0 m"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--cell", 50), "has its centre in the free space"),
        (
            (MAPS / "lab_a.json", "--bounce", 45, "--directions", 0),
            "--directions: expected at least 1",
        ),
        ((MAPS / "lab_a.json", "--bounce", 45, "--step", 0.2), "step: expected at least one cell"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--robot-radius", 9), "--robot-radius"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--start", "2,2,0"), "lies in an obstacle"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--start", "99,2,0"), "is off the map"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--start", "152"), "cell 152 does not exist"),
        ((MAPS / "lab_a.json", "--bounce", 45, "--start", "1,2"), 'expected "x,y,heading"'),
        ((MAPS / "lab_a.json", "--bounce", 45, "--start", "here"), 'expected "x,y,heading"'),
        ((MAPS, "--bounce", 45), "maps"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, args, message):
    status, found, errors = run(capsys, "localize", *args)
    assert (status, found) == (2, None)
    assert message in errors
    assert len(errors.strip().splitlines()) == 1


def test_unknown_options_end_with_status_2(capsys):
    for args in (["localize"], ["nothing"], ["groups", "map.json", "--bounce", "many"]):
        with pytest.raises(SystemExit) as ended:
            main(args)
        assert ended.value.code == 2
    capsys.readouterr()


def test_localize_compiles_nothing_and_imports_little():
    code = (
        "import jax, sys\n"
        "from jaxcell.cli import main\n"
        "compiled = []\n"
        "jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__:"
        " compiled.append(name) if 'backend_compile' in name else None)\n"
        "jax.jit(lambda x: x + 1)(2.5)\n"
        "assert compiled and not compiled.clear()\n"
        "for cell in ('1', '0.93'):\n"
        "    assert main(['localize', '@lab_a', '--cell', cell, '--bounce', '45']) == 0\n"
        "assert not compiled, compiled\n"
        "assert not {'scipy', 'xarray', 'pandas'} & sys.modules.keys()\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_help_imports_neither_numpy_nor_jax():
    code = (
        "import sys, jaxcell, jaxcell.cli\n"
        "try: jaxcell.cli.main(['--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "slow = {'jax', 'numpy', 'xarray', 'rerun', 'shapely'}\n"
        "assert not slow & sys.modules.keys(), slow & sys.modules.keys()"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    for command in ("localize", "groups", "export", "demo"):
        assert command in result.stdout


@pytest.mark.parametrize("package", ["space", "automata"])
def test_a_robot_needs_no_jax(package):
    code = f"import sys, jaxcell.{package}; assert 'jax' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
