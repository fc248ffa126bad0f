"""`--verify`: the summary tells what was compared, and the exit status whether it agrees."""

import json

import jax.numpy as jnp
import pytest

from jaxcell import bounce
from jaxcell.cli import main
from jaxcell.mapping import SimpleMap


GROUPS = ["groups", "@lab_a", "--bounce", "45"]


def test_verification_prints_a_line(capsys):
    line = "navigate @lab_a --bounces 45 135 --start 0 --goal 60 --verify"
    assert main(line.split()) == 0
    assert "numbers agree with another method" in capsys.readouterr().err


@pytest.mark.parametrize("json_too", [True, False])
def test_a_wrong_result_is_reported_with_status_1(json_too, capsys, monkeypatch):
    right = bounce.bounce_map

    def wrong(*args, **options):
        found = right(*args, **options)
        # Every cell but those at walls: the robot does not move.
        still = jnp.arange(found.image.size, dtype=jnp.int32)
        return SimpleMap(jnp.where(found.bumped, found.image, still), found.bumped)

    monkeypatch.setattr(bounce, "bounce_map", wrong)
    options = ["--json"] if json_too else []
    assert main([*GROUPS, "--verify", *options]) == 1
    printed = capsys.readouterr()
    assert "jaxcell groups: --verify: images of cells, by shapely one step" in printed.err
    assert "agree with" not in printed.err
    if json_too:
        assert not json.loads(printed.out)["verified"]["agrees"]
    # Without it nothing is computed again.
    assert main([*GROUPS, "--json"]) == 0
    assert "verified" not in json.loads(capsys.readouterr().out)
