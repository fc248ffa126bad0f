"""What chunks gave that is in no file yet: a file that holds several is written once for many."""

import dataclasses
import math
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from .boxes import inside
from .failures import remove_report
from .frame import fill
from .spec import Chunk
from .states import DONE, FAILED, TO_DO
from .workers.halving import Parts


if TYPE_CHECKING:
    from .store import SweepStore


# A kill loses what ended in this time, or in so many times that which it takes to write it.
_SECONDS = 1.0
_TIMES = 10
_MAX_BYTES = 2**28


@dataclasses.dataclass
class _Held:
    """A box in memory."""

    box: Chunk
    values: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    ended: list[int] = dataclasses.field(default_factory=list)
    "Chunks without failures that ended since it was written."
    changed: bool = False


class Pending:
    """The boxes of a store in which chunks end.

    A box is written as soon as nothing is to do in it, by another thread; and the others a second
    later at most, or where they are many so that a tenth of the time goes into it.
    """

    def __init__(self, store: "SweepStore") -> None:
        self._store = store
        self._held: dict[int, _Held] = {}
        self._bytes = 0
        self._due = -math.inf
        # They start when they are needed.
        self._team = ThreadPoolExecutor()
        self._writing: Future[None] | None = None
        "One box at a time, so that no other touches it, and few are in memory."

    def add(self, parts: Parts) -> None:
        """Take what is known of the members of a chunk that are missing."""
        self.wait()
        store, chunk = self._store, parts.chunk
        box = store.boxes.around(chunk)
        held = self._held.setdefault(box.number, _Held(box))
        held.changed = True
        members = store.members()
        states, place = members[chunk.region], inside(chunk, box)
        own = store.spec.places(chunk)
        missing = states != DONE
        for name in store.variables if parts.computed else ():
            if name not in held.values:
                held.values[name] = self._kept(name, box)
            inner = held.values[name]
            values = self._batch(fill(inner.dtype), inner.dtype, inner.shape[states.ndim :])
            for places, computed in parts.computed:
                values[places] = computed.variables[name].values
            inner[place][missing] = values[own][missing.ravel()]
        now = self._batch(TO_DO, states.dtype)
        now[list(parts.failed)] = FAILED
        for places, _ in parts.computed:
            now[places] = DONE
        states[missing] = now[own][missing.ravel()]
        if not parts.failed:
            held.ended.append(chunk.number)
        if (members[box.region] != TO_DO).all():
            self._let_go(held)
            self._writing = self._team.submit(self._write, held, members[box.region].copy())
        elif self._bytes > _MAX_BYTES or time.monotonic() >= self._due:
            self.write()

    def write(self) -> None:
        """Write all of it; boxes that are as they were when this was done last are let go."""
        self.wait()
        began = time.monotonic()
        for held in [*self._held.values()]:
            if held.changed:
                self._write(held, self._store.members()[held.box.region])
            else:
                self._let_go(held)
        if self._bytes > _MAX_BYTES:
            self._held.clear()
            self._bytes = 0
        ended = time.monotonic()
        self._due = ended + max(_SECONDS, _TIMES * (ended - began))

    def wait(self) -> None:
        """Wait until the box that is being written, if any, is on the disk."""
        writing, self._writing = self._writing, None
        if writing is not None:
            writing.result()

    def close(self) -> None:
        """Write all of it, and end."""
        with self._team:
            self.write()

    def _write(self, held: _Held, states: np.ndarray) -> None:
        """Write the results, and when they are on the disk the states."""
        store, box = self._store, held.box
        if store.boxes.several and not store.file("status", box).exists():
            # Where this is killed, no chunk of it is taken for half written.
            store.put("status", box, np.full(box.shape, TO_DO, np.int8))
        # A disk takes as long for one file as for several at once.
        list(self._team.map(lambda one: store.put(one[0], box, one[1]), held.values.items()))
        store.put("status", box, states)
        held.changed = False
        for number in held.ended:
            remove_report(store.folder, number)
        held.ended.clear()

    def _let_go(self, held: _Held) -> None:
        del self._held[held.box.number]
        self._bytes -= sum(values.nbytes for values in held.values.values())

    def _kept(self, name: str, box: Chunk) -> np.ndarray:
        """What a file holds of members that are done."""
        store = self._store
        if (store.members()[box.region] == DONE).any():
            values = store.read(name, box)
        else:
            values = store.empty(name, box)
        self._bytes += values.nbytes
        return values

    def _batch(self, value: Any, dtype: np.dtype, inner: tuple[int, ...] = ()) -> np.ndarray:
        """A value for each place in the batch of a chunk."""
        return np.full((math.prod(self._store.spec.lengths.values()), *inner), value, dtype)
