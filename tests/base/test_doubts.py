import networkx as nx
import numpy as np
import pytest

from jaxcell import markov, patrol, study


def doubted(call):
    with pytest.warns(UserWarning, match="as rounded numbers do|not read") as caught:
        call()
    return [warning.filename for warning in caught]


def test_a_warning_names_the_line_of_the_program():
    thirds = np.full((3, 3), 0.33333)
    assert doubted(lambda: markov.limiting_distribution(thirds)) == [__file__]
    weighted = nx.path_graph(3)
    nx.set_edge_attributes(weighted, 2.0, "weight")
    assert doubted(lambda: patrol.random_walk(weighted)) == [__file__]
    assert set(doubted(lambda: study.PatrolGraph(weighted).run())) == {__file__}
