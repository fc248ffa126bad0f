"""The table of all benchmarks; the benchmarks themselves are too long for a test."""

import importlib
import json
import re
import tomllib
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
ROW = {"benchmark": "good", "what": "this", "size": "9 cells", "ours_s": 0.5}
ROWS = [
    {**ROW, "peer": "scipy", "peer_s": 2.0, "ratio": 4.0},
    {**ROW, "peer": "gldpy", "peer_s": None, "ratio": None},
    {**ROW, "peer": None, "peer_s": None, "ratio": None},
]
PAGE = "before\n<!-- bench -->\nold\n<!-- /bench -->\nafter\n"


@pytest.fixture(scope="module")
def benchmarks():
    """The modules beside the benchmarks, by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "experiments" / "benchmarks")
        yield {name: importlib.import_module(name) for name in ("machine", "rows", "timing", "run")}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "page.md").write_text(PAGE)
    script(tmp_path, "good", f"Path(sys.argv[2]).write_text({json.dumps(ROWS)!r})")
    return tmp_path


def script(folder, name, does):
    lines = ("import sys", "from pathlib import Path", "assert sys.argv[1] == '--rows'", does)
    (folder / f"bench_{name}.py").write_text("\n".join(lines))


def make_bench(benchmarks, folder, *more):
    return benchmarks["run"].main(
        [
            *("--scripts", str(folder), "--logs", str(folder / "logs")),
            *("--page", str(folder / "page.md"), "--json", str(folder / "bench.json")),
            *more,
        ]
    )


def test_make_bench_installs_the_peers(benchmarks):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    recipe = re.search(
        r'--editable "\.\[([\w,]+)\]" --group bench', (ROOT / "Makefile").read_text()
    )
    chosen = recipe[1].split(",")
    installed = [*project["project"]["dependencies"], *project["dependency-groups"]["bench"]]
    for extra in chosen:
        # The list grows by the extras of an extra.
        for one in extras[extra]:
            own = re.fullmatch(r"jaxcell\[([\w,]+)\]", one)
            chosen += own[1].split(",") if own else ()
            installed.append(one)
    names = {"jaxcell", *(re.match(r"[\w-]+", one)[0].lower() for one in installed)}
    assert names >= {*benchmarks["machine"].PACKAGES}


def test_all_rows_are_written_and_the_page_shows_them(benchmarks, folder, capsys):
    assert make_bench(benchmarks, folder) == 0
    whole = json.loads((folder / "bench.json").read_text())
    assert whole["rows"] == ROWS
    assert whole["failed"] == []
    assert whole["versions"]["jax"]
    assert {"cpu", "cores", "memory_gb", "date"} <= set(whole["machine"])
    before, table, after = (folder / "page.md").read_text().partition("| good |")
    assert before.startswith("before\n<!-- bench -->\n| ")
    assert "old" not in before
    assert (
        table + after.splitlines()[0] == "| good | this | 9 cells | 500 ms | scipy | 2.0 s | 4.0 |"
    )
    assert "| gldpy | - |  |" in after
    assert whole["versions"]["jax"] in after
    assert after.endswith("<!-- /bench -->\nafter\n")
    assert "500 ms" in capsys.readouterr().out


def test_times_of_a_gpu_are_a_column(benchmarks, folder, capsys):
    assert make_bench(benchmarks, folder) == 0
    there = json.loads((folder / "bench.json").read_text())
    for row in there["rows"]:
        row["ours_s"] = 0.25
    (folder / "gpu.json").write_text(json.dumps(there))
    options = ["--gpu", str(folder / "gpu.json")]
    assert make_bench(benchmarks, folder, *options) == 0
    page = (folder / "page.md").read_text()
    assert "| jaxcell | on a GPU | peer |" in page
    assert "| good | this | 9 cells | 500 ms | 250 ms | scipy | 2.0 s | 4.0 |" in page
    (folder / "gpu.json").write_text("{}")
    with pytest.raises(SystemExit, match="2"):
        make_bench(benchmarks, folder, *options)
    assert "gpu.json: expected a file of --json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("does", "message"),
    [
        ("print('first'); sys.exit('they disagree')", "exit status 1: they disagree"),
        ("pass", "no rows"),
        ("Path(sys.argv[2]).write_text('[]')", "no rows"),
        ("Path(sys.argv[2]).write_text('[{}]')", "no rows"),
        ("Path(sys.argv[2]).write_text('half of')", "no rows"),
    ],
)
def test_others_go_on_where_one_fails(benchmarks, folder, capsys, does, message):
    script(folder, "bad", does)
    assert make_bench(benchmarks, folder) == 1
    whole = json.loads((folder / "bench.json").read_text())
    assert whole["failed"] == ["bench_bad.py"]
    assert whole["rows"] == ROWS
    assert (folder / "page.md").read_text() == PAGE
    shown = capsys.readouterr().err
    assert f"FAILED: {message}" in shown
    assert "failed: bench_bad.py; page.md is unchanged" in shown
