"""Own computations of rounds, which share nothing with the library."""

import itertools
import math

import networkx as nx
import numpy as np
import scipy.optimize


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


def least_risk(edges, attack, value, robots=1):
    """Compute the least risk of all strategies; edges have whole times, and all is a target."""
    after = {v: [v] for v in range(len(attack))}
    for a, b, time in [*edges, *((b, a, time) for a, b, time in edges)]:
        place = a
        for _ in range(time - 1):
            new = len(after)
            after[place].append(new)
            after[new], place = [], new
        after[place].append(b)
    longest = [math.ceil(a) for a in attack]
    first = (0,) * robots, tuple(longest)
    number, moves, stack = {first: 0}, [], [first]
    while stack:
        at, ages = state = stack.pop()
        for there in itertools.product(*(after[place] for place in at)):
            # The part of the next unit of time in which an attack is over, and no robot is there.
            late = [min(1.0, max(0.0, age + 1 - a)) for age, a in zip(ages, attack, strict=True)]
            late = [0.0 if v in at else one for v, one in enumerate(late)]
            grown = tuple(
                0 if v in there else min(age + 1, longest[v]) for v, age in enumerate(ages)
            )
            key = tuple(sorted(there)), grown
            if key not in number:
                number[key] = len(number)
                stack.append(key)
            moves.append((number[state], number[key], late))
    begins, ends = (np.array([move[k] for move in moves]) for k in (0, 1))
    balance = np.zeros((len(number) + 1, len(moves) + 1))
    np.add.at(balance, (begins, np.arange(len(moves))), 1.0)
    np.add.at(balance, (ends, np.arange(len(moves))), -1.0)
    balance[-1, :-1] = 1.0
    rows = np.array([move[2] for move in moves]).T * np.array(value)[:, None]
    rows = np.append(rows, -np.ones((len(attack), 1)), axis=1)
    cost = np.append(np.zeros(len(moves)), 1.0)
    total = np.append(np.zeros(len(number)), 1.0)
    return scipy.optimize.linprog(cost, rows, np.zeros(len(attack)), balance, total).fun


def draw_game_on_a_tree(random, seed):
    """Draw edges with whole times, and the attacks, values and number of robots of a game."""
    vertices = int(random.integers(2, 5))
    tree = nx.random_labeled_tree(vertices, seed=seed)
    edges = [(a, b, int(random.integers(1, 3))) for a, b in tree.edges]
    attack, value = random.integers(1, 4, (2, vertices)).tolist()
    return edges, attack, value, int(random.integers(1, min(vertices, 3)))
