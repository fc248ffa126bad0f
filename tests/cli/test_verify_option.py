"""`--verify`: the summary tells what was compared, and the exit status whether it agrees."""

import jax.numpy as jnp
import pytest
from helpers import run

from jaxcell import bounce
from jaxcell.cli import main
from jaxcell.mapping import SimpleMap


GROUPS = ["groups", "@lab_a", "--bounce", "45"]


def test_verification_prints_a_line(capsys):
    line = "navigate @lab_a --bounce 45 135 --start 0 --goal 60 --verify"
    assert main(line.split()) == 0
    assert "numbers agree with another method" in capsys.readouterr().err


def test_a_command_that_compares_nothing_refuses_the_option(capsys):
    assert main(["morse", "henon", "--verify"]) == 2
    assert "--verify: nothing is compared by `morse`; leave it out" in capsys.readouterr().err


@pytest.mark.parametrize("json_too", [True, False])
def test_a_wrong_result_is_reported_with_status_1(json_too, capsys, monkeypatch):
    right = bounce.bounce_map

    def wrong(*args, **options):
        found = right(*args, **options)
        # Every cell but those at walls: the robot does not move.
        still = jnp.arange(found.image.size, dtype=jnp.int32)
        return SimpleMap(jnp.where(found.bumped, found.image, still), found.bumped)

    monkeypatch.setattr(bounce, "bounce_map", wrong)
    if json_too:
        status, found, error = run(capsys, *GROUPS, "--verify")
        assert not found["verified"]["agrees"]
    else:
        status, error = main([*GROUPS, "--verify"]), capsys.readouterr().err
    assert status == 1
    assert "jaxcell groups: --verify: images of cells, by shapely one step" in error
    assert "agree with" not in error
    # Without it nothing is computed again.
    status, found, _ = run(capsys, *GROUPS)
    assert status == 0
    assert "verified" not in found
