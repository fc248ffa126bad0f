"""What chunks gave that is in no file yet: a thread writes it, once for many of them."""

import dataclasses
import math
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from .boxes import inside
from .failures import remove_report
from .spec import Chunk
from .storage.codecs import fill_of
from .storage.states import DONE, FAILED, TO_DO
from .workers.halving import Parts


if TYPE_CHECKING:
    from .storage.store import SweepStore


# A kill loses what ended in this time, or in so many times that which it takes to write it.
_SECONDS = 1.0
_TIMES = 10
_MAX_BYTES = 2**28

_File = tuple[str, Chunk, np.ndarray]


@dataclasses.dataclass
class _Held:
    """A box in memory."""

    box: Chunk
    values: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    ended: list[int] = dataclasses.field(default_factory=list)
    "Chunks without failures that ended since it was written."
    changed: bool = False
    "Whether chunks ended since then."


@dataclasses.dataclass(frozen=True)
class _Taken:
    """What is to be written."""

    values: list[_File]
    states: list[_File]
    ended: list[int]


class Pending:
    """The boxes of a store in which chunks end, and the thread that writes them.

    It writes a second after it did so last, or where that takes long, after ten times as long. What
    ends later is written at once.
    """

    def __init__(self, store: "SweepStore") -> None:
        self._store = store
        self._held: dict[int, _Held] = {}
        self._bytes = 0
        self._due = time.monotonic() + _SECONDS
        self._closing = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        "Whoever has it may look at what is held, and change it and the states in memory."
        self._team = ThreadPoolExecutor()
        self._thread = threading.Thread(target=self._serve)

    def add(self, parts: Parts) -> None:
        """Take what is known of the members of a chunk that are missing.

        **Raises:** `OSError` if what was taken before cannot be written.
        """
        with self._changed:
            if self._thread.ident is None:
                self._thread.start()
            self._changed.wait_for(lambda: self._bytes <= _MAX_BYTES or self._error is not None)
            if self._error is not None:
                raise self._error
            self._merge(parts)
            self._changed.notify_all()

    def close(self) -> None:
        """Write all of it, and end.

        **Raises:** `OSError` if it cannot be written.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()
        self._team.shutdown()
        if self._error is not None:
            raise self._error

    def _merge(self, parts: Parts) -> None:
        store, chunk = self._store, parts.chunk
        box = store.boxes.around(chunk)
        held = self._held.setdefault(box.number, _Held(box))
        held.changed = True
        states, place = store.members()[chunk.region], inside(chunk, box)
        own = store.spec.places(chunk)
        missing = states != DONE
        for name in store.variables if parts.computed else ():
            if name not in held.values:
                held.values[name] = self._kept(name, box)
            inner, fill = held.values[name], fill_of(store.metadata[name])
            values = self._batch(fill, inner.dtype, inner.shape[states.ndim :])
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

    def _serve(self) -> None:
        """Write until it is closed."""
        try:
            while (taken := self._take()) is not None:
                began = time.monotonic()
                self._write(taken)
                ended = time.monotonic()
                self._due = ended + max(_SECONDS, _TIMES * (ended - began))
                self._let_go()
        except BaseException as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _take(self) -> _Taken | None:
        """Wait until something is to be written, or until it is closed and nothing is."""
        store, condition = self._store, self._changed
        with condition:
            condition.wait_for(lambda: self._closing or self._to_write())
            patience = self._due - time.monotonic()
            condition.wait_for(lambda: self._closing or self._bytes > _MAX_BYTES, patience)
            taken = _Taken([], [], [])
            for held in self._to_write():
                for name, values in held.values.items():
                    # A box of one chunk does not change any more.
                    own = values.copy() if store.boxes.several else values
                    taken.values.append((name, held.box, own))
                states = store.members()[held.box.region].copy()
                taken.states.append(("status", held.box, states))
                taken.ended.extend(held.ended)
                held.changed, held.ended = False, []
            return taken if taken.states else None

    def _to_write(self) -> list[_Held]:
        return [held for held in self._held.values() if held.changed]

    def _write(self, taken: _Taken) -> None:
        """Write the results, and when they are on the disk the states."""
        store = self._store
        # Where this is killed, no chunk that was to do is taken for half written.
        self._put(
            [
                (name, box, np.full_like(states, TO_DO))
                for name, box, states in taken.states
                if (states == TO_DO).any() and not store.file(name, box).exists()
            ]
        )
        self._put(taken.values)
        self._put(taken.states)
        for number in taken.ended:
            remove_report(store.folder, number)

    def _put(self, files: Sequence[_File]) -> None:
        # A disk takes as long for one file as for several at once.
        list(self._team.map(lambda one: self._store.put(*one), files))

    def _let_go(self) -> None:
        """Forget the boxes of which no chunk ended since they were written."""
        with self._changed:
            for number, held in [*self._held.items()]:
                if not held.changed:
                    del self._held[number]
                    self._bytes -= sum(values.nbytes for values in held.values.values())
            self._changed.notify_all()

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
