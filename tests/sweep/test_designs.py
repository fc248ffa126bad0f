"""Designs of samples, and the Sobol indices that are estimated from one."""

import math

import numpy as np
import pytest
import sweep_stub
import xarray as xr
from helpers import run
from scipy.stats import qmc

from jaxcell.cli import main
from jaxcell.sweep import Spec, run_sweep, sobol_indices


def columns(folder, table, name="spec.toml", head=""):
    """The parameters of a specification with a table `[random]`, by name."""
    path = folder / name
    path.write_text(f'task = "a:b"\n{head}\n[random]\n{table}\n')
    return {one.name: one.values for one in Spec.load(path).parameters}


@pytest.mark.parametrize("design", ["sobol", "latin_hypercube"])
def test_a_design_fills_its_box_evenly(tmp_path, design):
    values = columns(
        tmp_path,
        f'samples = 64\ndesign = "{design}"\n'
        "u = {uniform = [-2, 2]}\nl = {loguniform = [1, 1024]}\nn = {normal = [5, 2]}\n"
        "i = {integers = [1, 8]}\nc = {choice = ['p', 'q', 'r', 's']}",
    )
    assert values["i"].dtype == np.int64
    # Each 64th of the distribution has one sample, and so each value of eight has eight.
    for unit in ((values["u"] + 2) / 4, np.log2(values["l"]) / 10):
        assert sorted((unit * 64).astype(int)) == list(range(64))
    assert np.bincount(values["i"]).tolist() == [0] + [8] * 8
    assert {name: (values["c"] == name).sum() for name in "pqrs"} == dict.fromkeys("pqrs", 16)
    normal = np.array([0.5 * math.erfc(-(x - 5) / 2 / math.sqrt(2)) for x in values["n"]])
    assert sorted((normal * 64).astype(int)) == list(range(64))
    # More evenly than chance in two dimensions: that of independent samples is about 0.02.
    unit = np.stack([(values["u"] + 2) / 4, normal], axis=1)
    assert qmc.discrepancy(unit) < 0.01


def test_a_design_depends_on_the_seed(tmp_path):
    table = 'samples = 8\ndesign = "sobol"\nx = {uniform = [0, 1]}'
    first = columns(tmp_path, table)["x"]
    np.testing.assert_array_equal(first, columns(tmp_path, table, head="chunk = 2")["x"])
    assert (first != columns(tmp_path, table, head="seed = 1")["x"]).all()


def test_saltelli_changes_one_parameter_at_a_time(tmp_path):
    axes = "".join(f"{name} = {{uniform = [0, 1]}}\n" for name in "xyz")

    def points(samples):
        table = f'samples = {samples}\ndesign = "saltelli"\n{axes}'
        return np.stack([*columns(tmp_path, table).values()], axis=1)

    values = points(8).reshape(8, 5, 3)
    a, b = values[:, 0], values[:, 1]
    assert (a != b).all()
    for i in range(3):
        changed = np.arange(3) == i
        np.testing.assert_array_equal(values[:, 2 + i], np.where(changed, b, a))
    # More samples begin with the same members.
    np.testing.assert_array_equal(points(16)[:40], values.reshape(40, 3))


def test_wide_integers_of_a_design(tmp_path):
    ends = "[-9223372036854775808, 9223372036854775807]"
    values = columns(tmp_path, f'samples = 4\ndesign = "sobol"\nx = {{integers = {ends}}}')["x"]
    assert sorted(values // 2**62) == [-2, -1, 0, 1]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("samples = 4\ndesign = 'grid'", "random.design: expected one of sobol, latin_hypercube"),
        ("samples = 4\ndesign = ['sobol']", "random.design: expected one of sobol"),
        ("samples = 6\ndesign = 'sobol'", "random.samples: expected a power of 2 .* sobol, got 6"),
        ("samples = 4194304\ndesign = 'saltelli'", "expected at most 10000000 members"),
    ],
)
def test_unknown_designs_are_refused(tmp_path, table, message):
    with pytest.raises(ValueError, match=message):
        columns(tmp_path, f"{table}\nx = {{uniform = [0, 1]}}")


ISHIGAMI = f"""
[random]
samples = 1024
design = "saltelli"
x1 = {{uniform = [{-math.pi}, {math.pi}]}}
x2 = {{uniform = [{-math.pi}, {math.pi}]}}
x3 = {{uniform = [{-math.pi}, {math.pi}]}}
"""


@pytest.fixture
def ishigami(tmp_path, monkeypatch):
    """A sweep of the function of Ishigami, with the exponent of a grid."""

    def task(batch, fixed, seed):
        x1, x2, x3 = (batch[name] for name in ("x1", "x2", "x3"))
        y = np.sin(x1) + 7 * np.sin(x2) ** 2 + batch["b"] * x3**4 * np.sin(x1)
        broken = np.where(x1 > 3, np.nan, y)
        return xr.Dataset({"y": ("member", y), "broken": ("member", broken)})

    monkeypatch.setattr(sweep_stub, "stub", task)
    path, out = tmp_path / "spec.toml", tmp_path / "out"
    grid = "[grid]\nb = [0.0, 0.1]\n"
    path.write_text('task = "sweep_stub:stub"\nchunk = 8192\n' + grid + ISHIGAMI)
    assert run_sweep(Spec.load(path), out).complete
    return out


def analytic(b):
    """First-order and total indices of the function of Ishigami, by its variances."""
    of_1 = 0.5 * (1 + b * math.pi**4 / 5) ** 2
    of_2 = 7**2 / 8
    of_13 = b**2 * math.pi**8 * (1 / 18 - 1 / 50)
    whole = of_1 + of_2 + of_13
    first, total = (of_1, of_2, 0.0), (of_1 + of_13, of_2, of_13)
    return [[part / whole for part in parts] for parts in (first, total)]


def test_sobol_indices_of_the_function_of_ishigami(ishigami, capsys):
    indices = run(capsys, "sweep indices", ishigami)[1]["indices"]
    # None for a variable that is not finite.
    assert [(one["variable"], one["at"]["b"], one["parameter"]) for one in indices] == [
        ("y", b, name) for b in (0.0, 0.1) for name in ("x1", "x2", "x3")
    ]
    for b, three in ((0.0, indices[:3]), (0.1, indices[3:])):
        for kind, expected in zip(("first_order", "total"), analytic(b), strict=True):
            np.testing.assert_allclose([one[kind] for one in three], expected, atol=0.03)
            for one, index in zip(three, expected, strict=True):
                low, high = one[f"{kind}_interval"]
                assert low - 0.01 <= index <= high + 0.01
                assert high - low < 0.2


def test_sobol_indices_of_finite_variables_are_printed(stub_spec, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.record.log_sweep", lambda *_, **__: None)
    monkeypatch.setattr("jaxcell.cli.sweep.view.has_display", lambda: False)
    text = '[random]\nsamples = 8\ndesign = "saltelli"\nx = {integers = [1, 9]}'
    run_sweep(stub_spec(text=text), tmp_path / "out")
    index = next(one for one in sobol_indices(tmp_path / "out") if one.variable == "value")
    for command in ("indices", "view"):
        assert main(["sweep", command, str(tmp_path / "out")]) == 0
        assert f"{index.total:.3f}" in capsys.readouterr().out


def test_sobol_indices_need_their_design_and_all_members(stub_spec, tmp_path):
    table = '[random]\nsamples = 4\ndesign = "{}"\nx = {{integers = [1, 9]}}'
    run_sweep(stub_spec(text=table.format("sobol")), tmp_path / "sobol")
    assert main(["sweep", "indices", str(tmp_path / "sobol")]) == 2
    with pytest.raises(ValueError, match='Sobol indices need the samples of design = "saltelli"'):
        sobol_indices(tmp_path / "sobol")
    spec = stub_spec(text=table.format("saltelli"), name="other.toml")
    run_sweep(spec, tmp_path / "out", chunks=[0])
    with pytest.raises(ValueError, match="Sobol indices need all members; 8 of 12 are not done"):
        sobol_indices(tmp_path / "out")
