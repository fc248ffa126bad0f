"""Quantities of a part are quantities of the result that has it."""

import dataclasses
from typing import Annotated

import pytest

from jaxcell.base.quantities import Result, quantities, quantity, values
from jaxcell.drift.results.flattened import flattened


@dataclasses.dataclass(frozen=True, eq=False)
class Speeds(Result):
    fastest: Annotated[float, quantity("", "fastest drifter", "m s-1", kind="number", note="1")]


@dataclasses.dataclass(frozen=True, eq=False)
class Race(Result):
    fastest: float | None
    computed: list[float]

    @flattened("speed_")
    def speeds(self) -> Speeds | None:
        if self.fastest is None:
            return None
        self.computed.append(self.fastest)
        return Speeds(self.fastest)


@dataclasses.dataclass(frozen=True, eq=False)
class LongRace(Race):
    pass


@pytest.mark.parametrize("kind", [Race, LongRace])
def test_a_result_has_the_quantities_of_its_part_with_a_prefix(kind):
    race = kind(2.5, [])
    assert quantities(kind) == {"speed_fastest": quantities(Speeds)["fastest"]}
    assert values(race)["speed_fastest"][1] == race.speed_fastest == 2.5
    assert race.computed == [2.5]


def test_a_result_without_the_part_lacks_its_quantities():
    race = Race(None, [])
    assert race.speed_fastest is None
    assert values(race) == {}
