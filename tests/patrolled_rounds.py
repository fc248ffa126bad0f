"""Own computations of rounds, which share nothing with the library."""

import itertools

import numpy as np


def waits(routes, target, moments, laps=3):
    """The time from each moment until a robot is at the target, by walking through all visits."""
    found = np.full(len(moments), np.inf)
    for i, moment in enumerate(moments):
        for route in routes:
            lap = moment // route.period
            for k, (vertex, arrive, leave) in itertools.product(
                range(-1, laps), zip(route.vertex, route.arrive, route.leave, strict=True)
            ):
                begin = (lap + k) * route.period
                if vertex == target and begin + leave >= moment:
                    found[i] = min(found[i], max(0.0, begin + arrive - moment))
    return found


def can_be_visited(near, robots, longest):
    """Check whether robots can visit each vertex at least every `longest` steps forever.

    The states are the vertices of the robots, and the steps since the last visit to each vertex; a
    search seeks a cycle of states.
    """
    vertices, dead = len(near), set()

    def after(state):
        found = set()
        for places in itertools.product(*(near[place] for place in state[0])):
            ages = tuple(0 if v in places else age + 1 for v, age in enumerate(state[1]))
            if max(ages) < longest:
                found.add((tuple(sorted(places)), ages))
        return iter(sorted(found, key=lambda one: sum(one[1])))

    for start in itertools.combinations_with_replacement(range(vertices), robots):
        state = start, (0,) * vertices
        stack, above = [(state, after(state))], {state}
        while stack:
            here, rest = stack[-1]
            for there in rest:
                if there in above:
                    return True
                if there not in dead:
                    stack.append((there, after(there)))
                    above.add(there)
                    break
            else:
                stack.pop()
                above.discard(here)
                dead.add(here)
    return False


def least_longest(graph, robots):
    """The least possible longest time between visits, in steps; robots may wait."""
    near = [[v, *graph[v]] for v in range(len(graph))]
    return next(n for n in itertools.count(1) if can_be_visited(near, robots, n))
