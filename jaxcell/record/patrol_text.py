"""What a stranger reads beside the pictures of a patroller's walk, in Markdown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..optimize import Graph
from ..patrol.walks.measures import Measures
from .texts import made_with


_MOST_ROWS = 60


def patrol_text(
    graph: Graph,
    measures: Measures,
    names: Sequence[str],
    robots: int,
    spec: Mapping[str, Any],
) -> str:
    """What the recording of a walk shows."""
    times = measures.hitting_times
    to = times.sum(axis=0) / (graph.vertices - 1)
    rows = ["| vertex | share of time | mean steps to it |", "| --- | --- | --- |"]
    for vertex in range(min(graph.vertices, _MOST_ROWS)):
        share = measures.stationary[vertex]
        rows.append(f"| {cell(names[vertex])} | {share:.4f} | {to[vertex]:.2f} |")
    if graph.vertices > _MOST_ROWS:
        rows.append(f"| {graph.vertices - _MOST_ROWS:,} more | | |")
    table = "\n".join(rows)
    mixing = (
        "it never forgets its start, because it is periodic"
        if math.isinf(measures.mixing_time)
        else f"after **{measures.mixing_time:,.0f}** steps it is within 1/4 of its shares of time, "
        "in total variation"
    )
    who = "A patroller walks" if robots == 1 else f"{robots} patrollers walk, each by itself,"
    return f"""# A random patrol

{who} on a graph of {graph.vertices:,} vertices and {len(graph.edges):,} edges. At each vertex the
next one is drawn at random, whatever came before: the walk is a *Markov chain*.

- From one vertex to another it takes **{measures.mean_hitting_time:.5g}** steps on average (the
  *hitting time*), there and back **{measures.mean_commute_time:.5g}** (the *commute time*).
- To a vertex drawn by the shares of time it takes {measures.kemeny_constant:.5g} (*Kemeny's
  constant*), wherever it starts.
- A step is as hard to guess as one of {math.exp(measures.entropy_rate):.3g} ways (the *entropy
  rate* is {measures.entropy_rate:.4g} nats).
- How fast it forgets: {mixing}. The second largest modulus of its eigenvalues is
  {measures.slem:.5g}.

## How to look

Press play, or drag the slider `step` at the bottom.

- **The walk**: wide yellow edges are walked often. Each patroller draws a line
  along its last steps.
- **Time since a visit**: a vertex is yellow when a patroller is there, and turns blue until the
  next visit. The curve is the longest such time.
- The tab **Where to next**: the half of an edge next to a vertex is wide and yellow if the
  patroller is likely to leave by it.
- The tab **Hitting times**: from the vertex of the row to that of the column.

{table}

{made_with(spec)}"""


def cell(text: str) -> str:
    """Text in a table, whose columns a bar would end."""
    return text.replace("|", "&#124;")
