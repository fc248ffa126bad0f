"""Every study answers alike as a library, as a command, in files, in a sweep and in a recording.

The studies of `STUDIES` and a study of a user are tested with the examples of their pages of help,
or with smaller arguments here.
"""

import contextlib
import dataclasses
import functools
import html
import io
import json
import re
import shlex
from pathlib import Path
from typing import Literal, NamedTuple, get_args, get_origin

import numpy as np
import pytest
import xarray as xr
from falling_stone import Drop
from matplotlib import pyplot
from rerun.chunk import RrdReader

from jaxcell.base.formatting import format_value
from jaxcell.base.quantities import columns, is_single, parts, summarized, values
from jaxcell.cli import main
from jaxcell.cli.app import COMMANDS
from jaxcell.cli.help import as_options, option
from jaxcell.cli.study_command import command_of
from jaxcell.cli.terminal import show
from jaxcell.cli.words import parsed
from jaxcell.record import dataset, summary
from jaxcell.record.figures.plot import picture
from jaxcell.study import STUDIES, Limit, Only, Study
from jaxcell.study.parameters import Unit, conditions, parameters, within, without_effect
from jaxcell.sweep.study_task import study_task


LAB = "@lab_a --collision endpoint"
GAMES = Path(__file__).parent / "games"
SEA = "@gyres --bounds -118.1 33.44 -118 33.54 --duration 3400"
CASES = {
    "angles": "@lab_a --for localize --count 2 --resolution 90 --robots 3 --bumps 6",
    "cover": "@lab_a --directions 8 --bounce 45 135 --errors turn=45 --reliability 0.8",
    "deploy": "@gyres --depth 0 --drop 2 --until 0.1 --avoid land",
    "drift": f"{SEA} --time 3 --depths 0 5 --start=-118.01,33.5 --goal=-118.09,33.46,5 --range 6e3",
    "drift by the source": f"{SEA} --depths 0 --method source --nearly-closed 2",
    "drift at beaches": f"{SEA} --depths 0 --time 3 --beaching 7200 --after 36000",
    "drifters": "@drifters --nearly-closed 2 --samples 4 --least 3 --cell 2 --after 100",
    "drifters counted": "@gdp --after 30 --from 90.9W,23.88N --to 88W,27N",
    "dynamics": "pendulum --cells 41 --params T=0.5 damping=0.2",
    "dynamics along a parameter": "henon --cells 40 --params a=1:1.4:3",
    "groups": f"{LAB} --bounce 45 135",
    "localize": f"{LAB} --bounce 135 --start 19",
    "localize by a choice of angles": f"{LAB} --bounce 45 135 --start 19",
    "localize at any offset": "@lab_a --bounce 135 --offsets",
    "localize slip": "@lab_a --bounce 45 --errors slip=0.02 --start 100",
    "localize anywhere": "@lab_a --bounce 135 --robots 3 --bumps 6",
    "navigate": "@lab_a --bounce 45 90 135 --start 0.5,0.5,0 --goal 7.5,3.5,0",
    "navigate anywhere": "@lab_a --bounce 45 135 --goal 1,3.5 --robots 3 --slices 72",
    "navigate slip": "@lab_a --bounce 45 135 --start 0 --goal 60 --errors slip=2%",
    "patrol graph": "@eight --robots 2 --game --emphasis 2 5 --base 3",
    "patrol graph attacked": "@eight --attack-time 12 --robots 2",
    "patrol graph toward": "@eight --strategy toward --vertex 3 --paths 2",
    "patrol graph in parts": "@eight --robots 2 --division partition --speed 0.5 --baselines",
    "patrol graph at a charger": "@eight --charger 2 --every 6",
    "patrol evaluate": f"{GAMES}/game.json {GAMES}/patrol.json",
    "patrol map": "@lab_a --range 3 --attack-times 4 9 --runs 50",
    "patrol map at a base": "@lab_a --range 3 --attack-times 4 --runs 50 --base auto",
    "plans": "@lab_a --bounce 45 135",
    "stone": "--height 20 --winds 3",
    "release": "@gyres --depth 0 --start=-117.93,33.5 --until 0.1 --precision 0.1",
    "rooms": "--room 1 --bounce 45 90 --columns 9 --rows 7 --obstacles 2 --directions 8",
    "team": "@lab_a --robots 2 --bounce 135",
}
NAMED = {**{study.command or study.task: study for study in STUDIES}, "stone": Drop}
CASES = {**{name: study.example for name, study in NAMED.items() if name not in CASES}, **CASES}


class Case(NamedTuple):
    """A study with small arguments, and all forms of its result."""

    study: Study
    result: object
    printed: dict
    table: str
    out: Path


def study_of(name):
    return next(NAMED[known] for known in sorted(NAMED, reverse=True) if name.startswith(known))


def verifies(name):
    return study_of(name).verify is not Study.verify


@pytest.fixture(scope="module")
def case(tmp_path_factory, few_drifters):
    """A function that runs a study by the library and by its command, when first called."""

    @functools.cache
    def run(name):
        kind, words = study_of(name), shlex.split(CASES[name])
        command = command_of(kind, kind.command or kind.task)
        out = tmp_path_factory.mktemp("out")
        given = [*words, "--out", str(out), *["--verify"] * verifies(name)]
        study = parsed(command, name, given).question
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert parsed(command, name, [*given, "--json"]).run() == 0
        result = study.run()
        with contextlib.redirect_stdout(io.StringIO()) as table, pytest.MonkeyPatch.context() as at:
            at.setenv("COLUMNS", "1000")
            show(result, study.headline(study.spec(result)))
        words = " ".join(table.getvalue().split())
        return Case(study, result, json.loads(printed.getvalue()), words, out)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.bounce.slip.fine_cells.SAMPLES", 8)
        patch.setattr("jaxcell.bounce.slip.fine_cells.MAX_CELLS", 3000)
        yield run


def same(one, other):
    """Return JSON values without the numbers that differ from run to run."""
    volatile = {"seconds", "filter_seconds", "difference", "iterations"}
    if isinstance(one, dict) and isinstance(other, dict):
        assert one.keys() == other.keys()
        return all(same(one[name], other[name]) for name in one if name not in volatile)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return one == pytest.approx(other, rel=1e-6, abs=1e-8, nan_ok=True)
    return one == other


def test_every_study_has_a_case():
    assert {study_of(name) for name in CASES} == {*STUDIES, Drop}
    commands = {study.command for study in STUDIES} - {""}
    assert commands <= COMMANDS.keys()
    for study in STUDIES:
        assert study.example or not study.command


@pytest.mark.parametrize("name", CASES)
def test_command_prints_what_the_library_computes(case, name):
    study, result, printed, _, out = case(name)
    begin = {"command": f"jaxcell {study.command or study.task}", **study.spec(result)}
    expected = json.loads(json.dumps({**begin, **summary(result)}))
    assert printed.keys() == {*expected, "seconds", *["verified"] * verifies(name)}
    assert same({key: printed[key] for key in expected}, expected)
    written = json.loads((out / "summary.json").read_text())
    assert written.pop("run_id") == json.loads((out / "result.json").read_text())["run_id"]
    assert written.pop("version") == 1
    assert written == printed


@pytest.mark.parametrize("name", [*filter(verifies, CASES)])
def test_independent_methods_agree_with_the_result(case, name):
    verified = case(name)[2]["verified"]
    assert verified["agrees"]
    assert verified["count"] > 0


@pytest.mark.parametrize("name", CASES)
def test_dataset_holds_every_quantity_and_the_specification(case, name):
    study, result, _, _, out = case(name)
    expected = dataset(result, spec=study.spec(result))
    with xr.open_dataset(out / f"{study.name}.nc", decode_times=False) as kept:
        assert set(kept.variables) == set(expected.variables)
        for key, (about, value) in values(result).items():
            assert kept[key].attrs["long_name"] == about.meaning
            if np.asarray(value).dtype.kind in "bi" and "sha" not in key:
                np.testing.assert_array_equal(kept[key], expected[key])
        assert json.loads(kept.attrs["spec"]) == json.loads(expected.attrs["spec"])
        assert json.loads(kept.attrs["spec"]) == json.loads(json.dumps(study.spec(result)))


@pytest.mark.parametrize("name", CASES)
def test_table_shows_the_numbers_of_the_summary(case, name):
    study, result, _, table, _ = case(name)
    assert study.headline(study.spec(result)) in table
    shown = summarized(result)
    brief = {key: one for key, one in shown.items() if key in result.brief} or shown
    cells = getattr(result, "cells", None)
    for about, value in brief.values():
        if is_single(about) and not set(about.dims) & set(result.tables):
            assert about.meaning in table
            assert " ".join(format_value(value, about, cells).split()) in table
    assert columns(result) or parts(result) or shown


@pytest.mark.parametrize("name", CASES)
def test_member_of_a_sweep_has_the_single_numbers(case, name):
    study, result, _, _, _ = case(name)
    given = {key: plain(getattr(study, key)) for key in parameters(type(study))}
    changed = {key: one for key, one in given.items() if getattr(study, key) != default(study, key)}
    # In other studies, several values are those of one member.
    apart = study.task in ("groups", "rooms")
    varied = [name for name in study.varied if name in changed]
    varied = [name for name in varied if apart or np.size(changed[name]) == 1]
    columns = np.broadcast_arrays(*(changed.pop(name) for name in varied))
    batch = {name: np.atleast_1d(one) for name, one in zip(varied, columns, strict=True)}
    member = xr.Dataset(study_task(type(study), batch, changed, seed=getattr(study, "seed", 0)))
    dims = ("bounce",) if apart else ()
    for key, (about, value) in values(result, lambda _, one: one.dims in ((), dims)).items():
        kind = np.asarray(value).dtype.kind
        if about.kind == "coordinate" or kind not in "biuf" or "seconds" in key:
            continue
        assert member[key].attrs["long_name"] == about.meaning
        expected = np.broadcast_to(np.asarray(value, float), member[key].shape)
        np.testing.assert_allclose(member[key].astype(float), expected, rtol=1e-6, atol=1e-8)


def plain(value):
    if isinstance(value, tuple):
        return [plain(part) for part in value]
    return str(value) if isinstance(value, Path) else value


def default(study, name):
    (field,) = (field for field in dataclasses.fields(study) if field.name == name)
    return field.default


@pytest.mark.parametrize("name", CASES)
def test_recording_opens_and_has_views(case, name):
    study, _, _, _, out = case(name)
    reader = RrdReader(out / f"{study.name}.rrd")
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    assert any(True for _ in reader.stream().to_chunks())


def others(hint):
    """Candidates for another value of a parameter."""
    if get_origin(hint) is Literal:
        return list(get_args(hint))
    nested = [value for part in get_args(hint) for value in others(part)]
    known = {bool: [True], int: [3, 1], float: [0.25, 3.0], str: ["1"], Path: [Path("x")]}
    if get_origin(hint) is tuple:
        return [(value,) for value in nested]
    return known.get(hint, nested)


@pytest.mark.parametrize("name", CASES)
def test_parameters_without_effect_are_refused_and_left_out(case, name):
    study, result = case(name)[:2]
    for parameter in without_effect(study):
        assert study.spec_name(parameter) not in study.spec(result)
        hint = parameters(type(study))[parameter]
        refused = 0
        for value in others(hint):
            if value == default(study, parameter):
                continue
            with pytest.raises(ValueError, match=rf"^{parameter}: expected|has an effect") as error:
                dataclasses.replace(study, **{parameter: value})
            message = str(error.value)
            refused += message.startswith(f"{parameter}: it has") or f"`{parameter}`" in message
        assert refused, parameter


@pytest.mark.parametrize("name", CASES)
def test_numbers_beyond_their_limits_are_refused(case, name):
    study = case(name).study
    for parameter, hint in parameters(type(study)).items():
        if (limit := within(hint, Limit)) is None:
            continue
        below = limit.gt if limit.ge is None else limit.ge - 1
        above = limit.lt if limit.le is None else limit.le + 1
        whole = re.search(r"\bint\b", str(hint)) is not None
        numbers = [number for number in (below, above) if number is not None]
        for number in numbers if whole else [*map(float, numbers), float("nan")]:
            value = (number,) if "tuple" in str(hint) else number
            unit = within(hint, Unit)
            after = "" if unit is None else f" {unit.word}"
            with pytest.raises(ValueError, match=f"^{parameter}: expected") as error:
                dataclasses.replace(study, **{parameter: value})
            assert str(error.value) == f"{parameter}: expected {limit}{after}, got {number:g}"


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_the_conditions_of_an_option(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "10000")
    kind = COMMANDS[name]
    with pytest.raises(SystemExit):
        main([*name.split(), "--help"])
    page = " ".join(capsys.readouterr().out.split())
    for parameter, alternatives in conditions(kind).items():
        assert option(kind, parameter) in page
        for condition in alternatives:
            assert condition.values.keys() <= parameters(kind).keys()
            assert as_options(kind, str(condition)) in page


def test_alternatives_hold_one_by_one():
    @dataclasses.dataclass
    class Options:
        a: int = 0
        b: str = "x"
        c: tuple = ()

    assert Only(a=True, b="x").holds(Options(a=1))
    assert not Only(a=True, b="x").holds(Options())
    assert Only(a=False, b=("y", "z")).holds(Options(b="z"))
    assert not Only(c=False).holds(Options(c=(1,)))
    assert (
        str(Only(a=True, b=("y", "z"), c=False)) == "with `a` and with `b` y or z and without `c`"
    )


@pytest.mark.parametrize("name", CASES)
def test_result_shows_itself_in_a_notebook(case, name):
    result = case(name).result
    text = result._repr_html_()
    assert html.escape(result.title) in text
    # A summary of costs has no array.
    assert (picture(result) is None) == ("<img" not in text)
    if picture(result) is not None:
        assert result.plot().get_title()
        pyplot.close("all")
