"""Games of patrols, and rounds that robots walk with a shared clock.

A `Game` has ways between vertices, each with a travel time in one direction, *targets* with attack
times and values, and a number of robots. An adversary attacks a target from a moment that he
chooses, and succeeds if no robot visits it until the attack time is over. He is *blind* if this
moment is random, and a *watcher* if he knows the plans of robots, and sees where they are. In
seconds he sees the vertex of a robot, or its way and direction, at any moment. In steps he sees it
before each step, and robots at vertices decide afterwards; the attack is stopped by visits in the
steps that it takes. Robots wait at any vertex, and walk each way to its end.

The plan of a robot is a `Route`, a list of visits that repeats. `evaluate` computes the longest
time between visits of all robots, and the *exposure* `e`: the share of moments at which an attack
succeeds. From the times `g` between visits in a period `T`, and the attack time `a`:

    e = sum over g of max(0, g - a) / T

No adversary escapes if the longest time between visits is at most `a`, whatever he knows. Robots
whose periods have no common multiple meet in all phases; then exposures multiply, and the longest
time is the least of theirs.

`best_rounds` searches for `Rounds` with the least risk, which is exposure times value: one closed
tour with evenly spaced robots, or several tours of some targets each, with some of the robots; if
targets differ, a tour may visit some of them several times. One robot on the shortest tour is
optimal for equal attack times: between two visits to some target it visits all others.
`best_routes` also does schedules in turn, and `best_mixture` draws one for each night. `bound`
computes what no patrol exceeds, and `Guarded` is the result for studies.

`load_game` and `save_game` read and write `game.json`, which `is_game` recognizes; `load_routes`
and `save_routes` read and write routes. `save_timetable` writes the times of a night.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
