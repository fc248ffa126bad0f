"""Reads NetCDF files in another process, because the C library may crash.

An input line is a JSON list of the reader and the file; an output line is the outcome.
"""

import contextlib
import json
import subprocess
import sys
import warnings
from pathlib import Path


class Worker:
    """The process, which is started again when it has died."""

    def __init__(self):
        self.deaths = []
        self._process = None

    def __call__(self, reader, path):
        """Reads a file. Returns "read", "refused", or the error, which a new process had too."""
        found = self._ask(reader, path)
        if found not in ("read", "refused") and self._process is not None:
            # Damaged files before may have left something wrong in the C library.
            self.close()
            found = self._ask(reader, path)
        return found

    def _ask(self, reader, path):
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, __file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        self._process.stdin.write(json.dumps([reader, str(path)]) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if line:
            return json.loads(line)
        status = self.close()
        self.deaths.append(status)
        return f"died with status {status}"

    def close(self):
        """Ends the process, and gives its exit status."""
        if self._process is None:
            return None
        process, self._process = self._process, None
        # The process may have ended before it read all input.
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        process.stdout.close()
        return process.wait()


def _answer(read, path):
    from mutations import TooSlowError, reads_or_refuses

    try:
        return "read" if reads_or_refuses(read, Path(path)) else "refused"
    except (Exception, TooSlowError) as error:
        places = []
        trace = error.__traceback__
        while trace is not None:
            places.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
            trace = trace.tb_next
        return f"{type(error).__name__}: {str(error)[:2000]} at {' '.join(places[-8:])}"


def _main():
    import jax

    jax.config.update("jax_enable_x64", True)
    import netCDF4  # noqa: F401
    import numpy as np

    from jaxcell.base.doubts import Doubt
    from jaxcell.cli.described import describe
    from jaxcell.drift import open_currents
    from jaxcell.space import CellSpace
    from jaxcell.study.bounce.target import read_target

    cells = CellSpace.of_grid(np.ones((2, 3), bool), 4)
    readers = {
        "currents": open_currents,
        "doctor": describe,
        "target": lambda path: read_target(cells, f"{path}:worth"),
    }
    # The first use of a library imports others.
    readers["doctor"](Path(__file__).parents[1] / "data" / "ocean" / "gyres.nc")
    readers["currents"](Path(__file__).parents[1] / "data" / "ocean" / "gyres.nc")
    warnings.simplefilter("error")
    # Damaged files deserve doubts.
    warnings.simplefilter("ignore", Doubt)
    for line in sys.stdin:
        reader, path = json.loads(line)
        print(json.dumps(_answer(readers[reader], path)), flush=True)


if __name__ == "__main__":
    _main()
