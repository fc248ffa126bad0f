import pytest

from jaxcell.study import Morse


@pytest.mark.parametrize("images", ["intervals", "mean-value", "corners"])
def test_images_with_proof_are_marked(images):
    sets = Morse(system="henon", cells=(4,), depth=4, images=images).run()
    assert sets.proved == (images != "corners")
    assert sets.remarks[0].startswith("Proved: " if sets.proved else "Nothing is proved: ")
    assert sets.plot().get_title() == "Morse set in the cell, -1 for none"


def test_several_values_of_a_parameter_are_refused():
    with pytest.raises(ValueError, match="params: a: expected one value, got 3"):
        Morse(system="henon", params=("a=1:1.4:3",)).run()
