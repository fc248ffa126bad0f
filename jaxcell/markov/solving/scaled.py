import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int


# The power of 2 of the number 0.
_NONE = -(2**40)
# Powers beyond these limits are 0 or infinite in 64 bits.
_FAR = 5000


@dataclasses.dataclass(frozen=True, eq=False)
class Scaled:
    """Numbers `part * 2**power` of any size, not negative; `part` is 0 or from 1/2 to 1."""

    part: Float[np.ndarray, "*shape"]
    power: Int[np.ndarray, "*shape"]

    @classmethod
    def of(cls, numbers: Float[np.ndarray, "*shape"], power: Any = 0) -> "Scaled":
        """Create the numbers `numbers * 2**power`."""
        part, more = np.frexp(numbers)
        return cls(part, np.where(part > 0, more.astype(np.int64) + power, _NONE))

    @property
    def numbers(self) -> Float[np.ndarray, "*shape"]:
        """The numbers in 64 bits, 0 or `inf` if they are beyond their range."""
        return _shifted(self.part, self.power)

    def __getitem__(self, place: Any) -> "Scaled":
        return Scaled(self.part[place], self.power[place])

    def __setitem__(self, place: Any, numbers: "Scaled") -> None:
        self.part[place], self.power[place] = numbers.part, numbers.power

    def __add__(self, other: "Scaled") -> "Scaled":
        power = np.maximum(self.power, other.power)
        one, two = (_shifted(each.part, each.power - power) for each in (self, other))
        return Scaled.of(one + two, power)

    def __mul__(self, other: "Scaled") -> "Scaled":
        return Scaled.of(self.part * other.part, self.power + other.power)

    def __truediv__(self, other: "Scaled") -> "Scaled":
        return Scaled.of(self.part / other.part, self.power - other.power)

    def sum(self, axis: int) -> "Scaled":
        power = self.power.max(axis=axis, initial=_NONE, keepdims=True)
        total = _shifted(self.part, self.power - power).sum(axis=axis)
        return Scaled.of(total, power.squeeze(axis))


def _shifted(
    part: Float[np.ndarray, "..."], power: Int[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    return np.ldexp(part, np.clip(power, -_FAR, _FAR).astype(np.int32))
