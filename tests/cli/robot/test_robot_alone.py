"""A computer on a robot runs a filter with the few packages of the dependency group `robot`."""

import importlib
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from robot_files import LAB, save_filter
from wheels import MAPS

import jaxcell.record.robot
from jaxcell import record, study
from jaxcell.cli import main


PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))
# Nothing can be imported but the standard library, jaxcell, and the packages that are named.
ALONE = """
import sys

ALLOWED = {"jaxcell", *sys.argv[1].split(","), *sys.stdlib_module_names}


class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in ALLOWED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Blocked())
from jaxcell.cli import main, terminal

# Lines of work that lasts depend on the machine.
terminal.FIRST_LINE = 3600.0
raise SystemExit(main(sys.argv[2:]))
"""


def name_of(requirement: str) -> str:
    return re.match(r"[\w.-]+", requirement).group().lower()


# The modules of each package of the group, and of what it needs itself.
MODULES = {
    "jaxtyping": "jaxtyping wadler_lindig",
    "lazy-loader": "lazy_loader packaging",
    "numpy": "numpy",
    "pillow": "PIL",
    "pyserial": "serial",
    "pyyaml": "yaml _yaml",
    "rich": "rich markdown_it mdurl pygments",
    "shapely": "shapely",
    "tyro": "tyro docstring_parser typeguard typing_extensions",
}


def on_a_robot(*words, cwd=None):
    """Call jaxcell where only the packages of the group `robot` are, and what these need."""
    # And what the environment of the tests puts into each process.
    modules = [*" ".join(MODULES.values()).split(), "_distutils_hack"]
    ran = subprocess.run(
        [sys.executable, "-c", ALONE, ",".join(modules), *map(str, words)],
        capture_output=True,
        text=True,
        timeout=200,
        cwd=cwd,
    )
    return ran.returncode, ran.stdout, ran.stderr


@pytest.fixture
def filter_file(tmp_path):
    return save_filter(tmp_path, map=str(MAPS / "lab_a.json"), name=LAB.workspace.name)


def test_dependencies_of_a_robot_are_those_of_the_library_and_of_the_extra_for_robots():
    group = set(PROJECT["dependency-groups"]["robot"])
    extra = set(PROJECT["project"]["optional-dependencies"]["robot"])
    assert {name_of(one) for one in group} == set(MODULES)
    assert extra < group
    assert group - extra < set(PROJECT["project"]["dependencies"])


def test_a_robot_runs_a_filter_without_the_rest(filter_file, tmp_path):
    out = tmp_path / "out"
    code, said, errors = on_a_robot(
        *("robot", "run", filter_file, "--simulate", MAPS / "lab_a.json", "--start", "70"),
        *("--heading", "135", "--speedup", "1e6", "--out", out, "--json"),
    )
    assert code == 0, errors
    found = json.loads(said)
    assert found["result"] == "localized"
    assert {path.name for path in out.iterdir()} == {
        *("result.json", "run.jsonl", "summary.json"),
    }
    again = shlex.join([f"{out}/run.jsonl", "--file", "filter.jxf", "--out", str(out)])
    assert f"jaxcell robot replay {again}" in errors


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["view", "."], "recordings need Rerun; install it with: pip install 'jaxcell[view]'"),
        (["robot", "run", "FILTER", "--live", "here", "--out", "o"], "pip install 'jaxcell[view]'"),
        (["localize", "MAP", "--bounce", "45"], "this command needs all of jaxcell: pip install "),
        (["robot", "run", "belief.jxb", "--port", "x"], "beliefs need SciPy; install it with: pip"),
    ],
)
def test_missing_packages_are_named(filter_file, tmp_path, words, message):
    names = {"FILTER": filter_file, "MAP": MAPS / "lab_a.json"}
    if "--live" in words:
        words = [*words, "--simulate", MAPS / "lab_a.json", "--heading", "0"]
    code, _, errors = on_a_robot(*(names.get(word, word) for word in words), cwd=tmp_path)
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1


def test_recordings_without_rerun_are_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    message = r"^recordings need Rerun; install it with: pip install 'jaxcell\[view\]'"
    groups = study.Groups(MAPS / "lab_a.json", bounce=45).run()
    with pytest.raises(ModuleNotFoundError, match=message):
        record.save_recording(groups, tmp_path / "one.rrd")
    with pytest.raises(ModuleNotFoundError, match=message):
        importlib.reload(jaxcell.record.robot)


def test_results_are_kept_without_recordings(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    out = tmp_path / "out"
    assert main(["groups", str(MAPS / "lab_a.json"), "--bounce", "45", "--out", str(out)]) == 0
    assert {path.suffix for path in out.iterdir()} == {".nc", ".json"}
    assert "No recording is written: recordings need Rerun" in capsys.readouterr().err
