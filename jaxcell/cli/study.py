"""The command of a study: its parameters are the options, its result is the output."""

import dataclasses
import json
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ..base.memory import gigabytes
from ..base.optional_modules import has_module, missing_module
from ..study import Study
from ..study.study import Say, silent
from .options import Printing, starting, write_text
from .terminal import (
    note,
    note_results,
    noting_warnings,
    progress,
    say as print_line,
    status,
    stdout_on_stderr,
)


if TYPE_CHECKING:
    from ..base.quantities import Result


# Bytes above which the need is printed.
_MUCH = 1e9


@dataclasses.dataclass(frozen=True, kw_only=True)
class Command(Printing):
    """What the commands of all studies take, and what they do."""

    study: ClassVar[type[Study]]
    called: ClassVar[str]

    out: Path | None = None
    """Directory for the results: NetCDF, a Rerun recording, summary.json."""
    verify: bool = False
    """Compute small parts of the result again by another route; exit with 1 if they differ."""

    @property
    def asked(self) -> Study:
        """The study with the parameters that are given as options."""
        return self.study(
            **{field.name: getattr(self, field.name) for field in dataclasses.fields(self.study)}
        )

    def answer(self, say: Say = silent) -> tuple["Result", dict[str, Any]]:
        """The result, and the object that is printed for `--json`."""
        from .. import record

        asked, began = self.asked, time.perf_counter()
        result = asked.run(say)
        say("summing up")
        found = record.summary(result)
        seconds = round(time.perf_counter() - began, 3)
        spec = asked.spec(result)
        return result, {"command": f"jaxcell {self.called}", **spec, **found, "seconds": seconds}

    def write(self, result: "Result", summary: dict[str, Any], out: Path) -> None:
        """Write the files of a result to a folder."""
        from .. import record

        asked = self.asked
        spec = asked.spec(result)
        out.mkdir(parents=True, exist_ok=True)
        if asked.at_once(result):
            record.save_dataset(record.dataset(result, spec=spec), out / f"{asked.name}.nc")
            if has_module("rerun"):
                record.save_recording(result, out / f"{asked.name}.rrd", spec=spec)
        asked.write(result, out)
        _write_summary(summary, out)

    def run(self) -> int:
        asked = self.asked
        asked.check_files()
        try:
            with status(f"reading for {self.called}"):
                needed = asked.memory(written=self.out is not None)
                if needed > _MUCH:
                    note(f"{self.called} needs about {gigabytes(needed)} of memory")
            with starting():
                from .. import record  # noqa: F401
            with stdout_on_stderr(), progress(self.called) as say, noting_warnings() as noted:
                result, summary = self.answer(say)
        except RuntimeError as error:
            note(f"jaxcell {self.called}: {error}")
            return 1
        if self.out is not None:
            with status(f"writing {self.out}"):
                self.write(result, summary, self.out)
        verified = _verified(asked, result) if self.verify else None
        if verified is not None:
            summary["verified"] = verified
            if self.out is not None:
                _write_summary(summary, self.out)
        drawn = asked.at_once(result)
        if self.json:
            print_line(json.dumps(summary))
        else:
            from .tables import show

            show(result, asked.headline(asked.spec(result)), summary["seconds"])
            if self.out is not None and drawn:
                note_results(self.out)
            elif self.out is not None:
                note(f"Results are in {self.out}, without a recording of so many cells.")
        if self.out is not None and drawn and not has_module("rerun"):
            note(f"No recording is written: {missing_module('rerun')}")
        for remark in result.remarks:
            if remark not in noted:
                note(remark)
        agrees = verified is None or _report(self.called, verified, quiet=self.json)
        return 0 if agrees and result.answered else 1


def _write_summary(summary: dict[str, Any], out: Path) -> None:
    write_text(out / "summary.json", json.dumps(summary, indent=2) + "\n")


def command(study: type[Study], called: str | None = None) -> Any:
    """The options and the run of a study's command.

    **Arguments:**

    - `study`: its class.
    - `called`: what the command is called; by default after the class.
    """
    more = {
        "__doc__": study.__doc__,
        # The parameters are checked when the study is made, not when the options are read.
        "__post_init__": lambda _: None,
        "study": study,
        "called": called or command_name(study),
    }
    return dataclasses.make_dataclass(
        study.__name__, [], bases=(Command, study), namespace=more, frozen=True, kw_only=True
    )


def command_name(study: type) -> str:
    """The name on the command line of a class: `patrol map` for `PatrolMap`."""
    return re.sub("(?<=[a-z])(?=[A-Z])", " ", study.__name__).lower()


def _verified(asked: Study, result: "Result") -> dict[str, Any]:
    """What comes of computing parts of a result again."""
    began = time.perf_counter()
    with status("computing parts again by another route"):
        found = asked.verify(result)
    return {
        "agrees": all(one.agrees for one in found),
        "count": sum(one.count for one in found),
        "seconds": round(time.perf_counter() - began, 3),
        "comparisons": [one.as_json() for one in found],
    }


def _report(name: str, verified: dict[str, Any], quiet: bool) -> bool:
    """Say on standard error what came of it."""
    for one in verified["comparisons"]:
        if not one["agrees"]:
            note(f"jaxcell {name}: --verify: {one['what']}: {one['where']}")
    if verified["agrees"] and not quiet:
        note(
            f"Verified: {verified['count']:,} numbers agree with another route, in "
            f"{verified['seconds']:g} s."
        )
    return bool(verified["agrees"])
