from collections.abc import Sequence

from .outcome import RunOutcome, actions_outcome
from .run_log import RunLog, finished
from .walker import Walker


def run_plan(
    walker: Walker, actions: Sequence[float | int], *, log: RunLog | None = None
) -> RunOutcome:
    """Drive a robot through the action string of a navigation plan (Alam 2018, section 3.4.1).

    **Arguments:**

    - `walker`: the robot, at the position and in the direction where the plan starts.
    - `actions`: the `actions` of a `jaxcell.bounce.Plan`: 0 for a step without a bump, else the
        angle in radians, counter-clockwise, of the turn after a bump.
    - `log`: the log, to which each observation is written immediately.

    **Returns:** [`RunOutcome`][]: `"refuted"` at the first step that bumps where the plan has free
    space, or does not bump where the plan has a wall; else `"arrived"`.

    A simulated robot in a corridor of three cells, which goes to the end and turns:

        >>> import math
        >>> from jaxcell import examples, robot
        >>> walker = examples.walker()
        >>> outcome = robot.run_plan(walker, [0.0, 0.0, math.pi / 2])
        >>> outcome.result, outcome.observations
        ('arrived', '001')
    """
    for index, action in enumerate(actions):
        bumped = walker.step()
        if log is not None:
            log.observation(walker, action=index)
        if bumped != (action != 0):
            break
        if bumped:
            walker.rotate(action)
    return finished(plan_outcome(actions, walker.observations), log)


def plan_outcome(actions: Sequence[float | int], observations: str) -> RunOutcome:
    """Compute the outcome so far of a plan that a robot executes, from its observations.

    **Arguments:** the actions, and an observation for each executed action, 0 for a step and 1 for
    a bump. **Returns:** the outcome.

    The second step bumped in free space:

        >>> from jaxcell import robot
        >>> robot.plan_outcome([0.0, 0.0], "01").result
        'refuted'
    """
    for index, (action, observation) in enumerate(zip(actions, observations, strict=False)):
        if (observation == "1") != (action != 0):
            problem = "the robot met no wall where the plan has one"
            if observation == "1":
                problem = "the robot bumped where the plan has free space"
            return actions_outcome(observations, index, len(actions), problem)
    return actions_outcome(observations, len(observations), len(actions))
