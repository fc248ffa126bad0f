from .packets import encoder_difference
from .reading import Reading


# The numbers of frames, one per 15 ms, after which a bump or a start cannot be the cause.
_STALL, _OVERCURRENT = 67, 20
# The encoder counts by which a blocked wheel may move, 2 mm.
_PLAY = 4


class Strain:
    """A detector of blocked wheels, updated with each frame of the stream.

    A wheel is blocked if it should turn but stands still for a second, or if its motor draws too
    much current for a third of a second. Shorter times are normal at a bump or a start.
    """

    def __init__(self) -> None:
        self._frames = [0, 0]
        self._counts: list[int | None] = [None, None]
        self._overcurrent = 0

    def observe(self, wheels: tuple[int, int], reading: Reading) -> str | None:
        """Update the detector with the next frame, and return the reason to stop, or `None`.

        `wheels` are the commanded speeds of the right and the left wheel, in mm/s.
        """
        self._overcurrent = self._overcurrent + 1 if reading.overcurrent and any(wheels) else 0
        if self._overcurrent >= _OVERCURRENT:
            return "a wheel is blocked: its motor draws too much current"
        left, right = reading.encoders
        for side, (name, count) in enumerate((("right", right), ("left", left))):
            before = self._counts[side]
            held = before is not None and abs(encoder_difference(before, count)) <= _PLAY
            if not (held and wheels[side]):
                self._frames[side], self._counts[side] = 0, count
                continue
            self._frames[side] += 1
            if self._frames[side] >= _STALL:
                return f"the {name} wheel is blocked: it does not turn"
        return None
