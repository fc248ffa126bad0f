from pathlib import Path

import numpy as np
import pytest

from jaxcell.record.bounce.anywhere import stretches
from jaxcell.study import Localize


LAB = Path(__file__).parents[2] / "data" / "maps" / "lab_a.json"


@pytest.mark.parametrize("heading", ["known", "unknown"])
def test_the_robot_is_on_a_stretch_after_each_bump(heading):
    asked = {"heading": heading, "robots": 1, "bumps": 8, "slices": 72, "directions": 8}
    found = Localize(map=LAB, bounce=135.0, anywhere=True, **asked).run()
    for bump, place in zip(found.bump.tolist(), found.trial.place[0], strict=True):
        begin, end = stretches(found, bump).swapaxes(0, 1)
        detour = np.hypot(*(place - begin).T) + np.hypot(*(place - end).T)
        assert (detour - np.hypot(*(end - begin).T)).min() < 1e-4
