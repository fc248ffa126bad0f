import math

import helpers
import numpy as np
import pytest
from robot_files import LAB, SPEC
from wheels import bounce_filter, map_cells

from jaxcell.automata import Filter, minimize, policy_to_c_header
from jaxcell.bounce import localization_policy
from jaxcell.cli import main
from jaxcell.cli.robot.sketch import RobotSketch
from jaxcell.robot.sketch import bounce_sketch, filter_sketch, policy_sketch
from jaxcell.robot.tasks.files import load_task


def test_a_filter_becomes_a_sketch(filter_file, tmp_path, capsys):
    out = tmp_path / "new" / "sketch" / "sketch.ino"
    assert RobotSketch(file=filter_file, heading=-90.0, out=out).run() == 0
    assert capsys.readouterr().out == ""
    assert out.read_text() == filter_sketch(load_task(filter_file), direction=6)
    assert RobotSketch(file=filter_file, heading=0.0).run() == 0
    assert capsys.readouterr().out == filter_sketch(load_task(filter_file), direction=0)
    with pytest.raises(ValueError, match=r"--heading: .* because the steps of .* differ between"):
        RobotSketch(file=filter_file).run()


def test_a_filter_of_equal_steps_becomes_a_sketch_without_a_heading(tmp_path, capsys):
    path = tmp_path / "filter.jxf"
    cells = map_cells("lab_a.json", directions=4)
    bounce_filter(cells, 90, metadata={**SPEC, "directions": 4, "bounce_deg": 90}).save(path)
    assert RobotSketch(file=path).run() == 0
    assert capsys.readouterr().out == filter_sketch(load_task(path))


def test_a_sketch_confirms_by_as_many_observations_as_asked(filter_file, tmp_path, capsys):
    assert RobotSketch(file=filter_file, heading=0.0, confirm=7).run() == 0
    task = load_task(filter_file)
    assert capsys.readouterr().out == filter_sketch(task, direction=0, confirm=7)
    with pytest.raises(ValueError, match="confirm: it has an effect only with"):
        RobotSketch(file=filter_file, heading=0.0, confirm=7, smallest=True).run()
    policy = tmp_path / "policy.jxf"
    spec = {**SPEC, "bounce_deg": [45.0, 135.0]}
    localization_policy(LAB, np.radians([45, 135]), metadata=spec).policy.save(policy)
    with pytest.raises(ValueError, match="--confirm: the sketch of a policy cannot confirm"):
        RobotSketch(file=policy, heading=0.0, confirm=7).run()


def test_a_minimal_filter_is_smaller(filter_file, capsys):
    assert RobotSketch(file=filter_file, heading=0.0, minimal=True).run() == 0
    states = len(minimize(Filter.load(filter_file)).transition)
    assert states < 129
    assert f"#define FILTER_STATES {states}u\n" in capsys.readouterr().out


def test_smallest_machines_are_exported_with_their_proof(filter_file, tmp_path, capsys):
    pytest.importorskip("pysat.solvers")
    for suffix in ("h", "dot", "json"):
        assert main(["export", str(filter_file), str(tmp_path / f"f.{suffix}"), "--smallest"]) == 0
        message = capsys.readouterr().err
        assert "44 states, proved least; 94 if only equivalent states are merged" in message
    assert "#define FILTER_STATES 44u" in (tmp_path / "f.h").read_text()
    assert RobotSketch(file=filter_file, heading=0.0, smallest=True).run() == 0
    assert "#define FILTER_STATES 44u\n" in capsys.readouterr().out


def test_a_choice_of_angles_becomes_a_sketch_and_a_header(tmp_path, capsys):
    file, header = tmp_path / "policy.jxf", tmp_path / "policy.h"
    spec = {**SPEC, "bounce_deg": [45.0, 135.0]}
    found = localization_policy(LAB, np.radians([45, 135]), metadata=spec)
    found.policy.save(file)
    assert RobotSketch(file=file, heading=90.0).run() == 0
    assert capsys.readouterr().out == policy_sketch(load_task(file), direction=2)
    assert main(["export", str(file), str(header)]) == 0
    assert header.read_text() == policy_to_c_header(found.policy)
    for path, more in ((header, ["--minimal"]), (tmp_path / "policy.dot", [])):
        assert main(["export", str(file), str(path), *more]) == 2
        assert "a policy is written only as .h, and without --minimal" in capsys.readouterr().err
    with pytest.raises(ValueError, match="--minimal: a policy has no equal states to merge"):
        RobotSketch(file=file, minimal=True).run()
    _, described, _ = helpers.run(capsys, "doctor", file)
    assert described["what"] == "a localization policy"
    assert (described["states"], described["largest_uncertainty"]) == (found.policy_states, 1)


def test_a_policy_becomes_a_sketch(capsys):
    assert RobotSketch(bounce=135.0, step=0.4).run() == 0
    assert capsys.readouterr().out == bounce_sketch(math.radians(135), 0.4)
