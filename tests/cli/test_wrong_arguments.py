"""Arguments of wrong types are refused in one sentence, also where no test checks types."""

import numpy as np
import pytest

from jaxcell import (
    automata,
    bounce,
    drift,
    dynamics,
    examples,
    markov,
    optimize,
    patrol,
    record,
    space,
    study,
    sweep,
)


P = np.eye(3)
LAB = examples.lab()
WRONG = {
    "bounce_map: cells: expected a CellSpace, got int; CellSpace.of": lambda: bounce.bounce_map(
        5, 1
    ),
    "bounce: expected an array of numbers, got str": lambda: bounce.bounce_map(LAB, "a"),
    "BounceGroups.of: cells: expected a CellSpace, got str": lambda: bounce.BounceGroups.of(
        "@lab_a", 1.0
    ),
    "localization_filter: simple_map: expected a SimpleMap": lambda: bounce.localization_filter(5),
    "hitting_times: chain: expected a Chain, got int": lambda: markov.hitting_times(5, 1),
    "limiting_distribution: groups: .*; persistent_groups": lambda: markov.limiting_distribution(
        P, 3
    ),
    "CellSpace.of: cell: expected a number, got 'a'": lambda: space.CellSpace.of(LAB.room, "a", 4),
    "CellSpace.of_grid: free: expected an array of numbers, got str": lambda: (
        space.CellSpace.of_grid("a", 4)
    ),
    "cells: expected a number for each axis, got 200": lambda: space.Box([0], [1], 200),
    "lower: expected a number for each axis, got 'a'": lambda: space.Box("a", [1], [2]),
    "nearest_cell: cells: expected a CellSpace, got int": lambda: space.nearest_cell(5, 0, 0, 0),
    "step: expected a length in metres, got 'a'": lambda: space.Motion("a"),
    "random_walk: graph: expected a Graph, got int; a graph of": lambda: patrol.random_walk(5),
    "distributed_policies: visible: expected an array": lambda: patrol.distributed_policies(
        optimize.Graph([[0, 1]]), 5, 1
    ),
    "path: expected a file, a list of files or a dataset": lambda: drift.open_currents(5),
    "SeaDrift.of: currents: expected a Dataset, got str; open_currents": lambda: drift.SeaDrift.of(
        "a"
    ),
    "basins: box: expected a Box, got int; Box": lambda: dynamics.basins(lambda x, p: x, 5),
    "Filter.of: automaton: expected an Automaton, got int": lambda: automata.Filter.of(5),
    "Spec.load: path: expected a path, got int": lambda: sweep.Spec.load(5),
    "dataset: result: expected a Result, got int; the method run": lambda: record.dataset(5),
}


@pytest.mark.parametrize("said", WRONG)
def test_wrong_arguments_are_refused_in_a_sentence(said):
    with pytest.raises(ValueError, match=said) as caught:
        WRONG[said]()
    assert "\n" not in str(caught.value)


def test_a_plot_names_the_dimension_whose_index_is_out_of_range():
    groups = study.Groups(map=LAB, bounce=(45.0,)).run()
    for index in (99, -9, "a"):
        with pytest.raises(
            IndexError, match=f"direction: {index!r} is out of range; expected 0 to 7"
        ):
            groups.plot("step", direction=index)
