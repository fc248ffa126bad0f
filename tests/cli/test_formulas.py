"""Formulas in the docstrings of packages, as the site shows them."""

import re
import runpy
from pathlib import Path

import pytest


pytest.importorskip("mkdocs")
HOOKS = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "hooks.py"))


@pytest.mark.parametrize(
    ("formula", "latex"),
    [
        ("p_ij >= 0", r"p_{ij} \ge  0"),
        ("(I - Q)^-1, x^2", r"(I - Q)^{-1},\; x^{2}"),
        ("C^(K-1)(z)", "C^{K-1}(z)"),
        ("P_{o_1} ... P_{o_n}", r"P_{o_{1}} \ldots  P_{o_{n}}"),
        ("2 pi k / N_S", r"2 \pi  k / N_{S}"),
    ],
)
def test_formulas_are_written_in_latex(formula, latex):
    assert HOOKS["is_formula"](formula)
    assert HOOKS["to_latex"](formula) == latex


@pytest.mark.parametrize("code", ["bounce_map", "jaxcell.mapping.Chain", "--slip", '"x"'])
def test_names_of_the_library_stay_code(code):
    assert not HOOKS["is_formula"](code)


def test_words_beside_a_formula_stay_words():
    html = HOOKS["mathematics"]("the step of z is the least s >= 0")
    assert html.startswith("the step of <math")
    assert "is the least <math" in html
    assert re.sub(r"<[^>]+>", "", html).startswith("the step of z is the least s")
