"""Commands that run studies: options are parameters of a study, and the output is its result."""

import contextlib
import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import tyro

from ..base.memory import check_addresses, gigabytes
from ..base.optional_modules import has_module, missing_module
from ..base.paths import name_in_results
from ..base.process import parts_kept, raise_lost_signal
from ..base.quantities import Result
from ..base.results import Manifest, current_run, result_folder
from ..study import STUDIES, Study
from ..study.study import Say, silent
from .help import as_options
from .output import Printing, option_words, write_text
from .startup import starting
from .terminal import (
    note,
    note_results,
    noting_warnings,
    progress,
    say,
    show,
    status,
    stdout_on_stderr,
)
from .words import parsed


MUCH = 1e9
"""The number of bytes above which an estimate of memory is printed."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """Run a study of your own; `jaxcell run FILE.py:CLASS --help` shows its options."""

    example: ClassVar[str] = "my_study.py:MyStudy --help"

    study: tyro.conf.Positional[str]
    """Class that derives from jaxcell.study.Study: FILE.py:CLASS or MODULE:CLASS."""

    def run(self) -> int:
        raise ValueError(f"{self.study}: expected FILE.py:CLASS or MODULE:CLASS")


@dataclasses.dataclass(frozen=True, kw_only=True)
class StudyCommand(Printing):
    """Base class of the commands of studies, with their common options."""

    study: ClassVar[type[Study]]
    command: ClassVar[str]

    out: Path | None = None
    """Folder for the results: NetCDF, a Rerun recording, summary.json."""
    verify: bool = False
    """Compare small parts of the result with another method; exit with 1 if they differ."""

    @property
    def question(self) -> Study:
        return self.study(
            **{field.name: getattr(self, field.name) for field in dataclasses.fields(self.study)}
        )

    def answer(self, say: Say = silent) -> tuple[Result, dict[str, Any]]:
        """Run the study, and return the result and the JSON object that `--json` prints."""
        from .. import record

        question, began = self.question, time.perf_counter()
        result = question.run(say)
        say("summing up")
        numbers = record.summary(result)
        seconds = round(time.perf_counter() - began, 3)
        begin = {"command": f"jaxcell {self.command}", **question.spec(result)}
        return result, {**begin, **numbers, "seconds": seconds}

    def write(self, result: Result, summary: dict[str, Any], folder: Path) -> None:
        """Write all files of a result to the hidden folder of a run."""
        from .. import record

        question = self.question
        spec = question.spec(result)
        if question.at_once(result):
            record.save_dataset(record.dataset(result, spec=spec), folder / f"{question.name}.nc")
            if has_module("rerun"):
                record.save_recording(result, folder / f"{question.name}.rrd", spec=spec)
        question.write(result, folder)
        text = json.dumps({"version": 1, "run_id": current_run(), **summary}, indent=2)
        write_text(folder / "summary.json", text + "\n")
        names = {field.name for field in dataclasses.fields(self.study)}
        words = [*self.command.split(), *option_words(self, names, name_in_results)]
        Manifest.of(folder, words, spec, question.digests()).write(folder)

    def run(self) -> int:
        with contextlib.nullcontext() if self.out is None else result_folder(self.out) as folder:
            computed = self._compute(folder)
        # The files are complete before the answer is printed, perhaps into a closed pipe.
        return 1 if computed is None else self._tell(*computed)

    def _compute(self, folder: Path | None) -> tuple[Any, ...] | None:
        """Compute and write the result; return `None` if there is none, after a note."""
        question = self.question
        question.check_files()
        if self.verify and self.study.verify is Study.verify:
            raise ValueError(f"verify: nothing is compared by `{self.command}`; leave it out")
        try:
            with noting_warnings(type(self)) as noted:
                with status(f"reading for {self.command}"):
                    needed = question.memory(written=folder is not None)
                    if needed > MUCH:
                        note(f"{self.command} needs about {gigabytes(needed)} of memory")
                with starting():
                    from .. import record  # noqa: F401
                with stdout_on_stderr(), progress(self.command) as show, parts_kept() as stopped:
                    result, summary = self.answer(show)
            raise_lost_signal()
            if stopped:
                note("Stopped: the answer is of what was computed until then.")
                summary["stopped"] = True
        except RuntimeError as error:
            note(f"jaxcell {self.command}: {error}")
            return None
        if self.verify:
            summary["verified"] = _verified(question, result)
        if folder is not None:
            with status(f"writing {self.out}"):
                self.write(result, summary, folder)
        return result, summary, noted, stopped

    def _tell(
        self, result: Result, summary: dict[str, Any], noted: list[str], stopped: list[int]
    ) -> int:
        """Print the answer, its remarks and doubts, and return the exit status."""
        self._print(self.question, result, summary)
        for remark in (as_options(type(self), remark) for remark in result.remarks):
            if remark not in noted:
                note(remark)
        verified = summary.get("verified")
        agrees = verified is None or _report(self.command, verified, quiet=self.json)
        return stopped[0] if stopped else int(not (agrees and result.answered))

    def _print(self, question: Study, result: Result, summary: dict[str, Any]) -> None:
        drawn = question.at_once(result)
        if self.json:
            say(json.dumps(summary))
        else:
            show(result, question.headline(question.spec(result)))
            if self.out is not None and drawn:
                note_results(self.out)
            elif self.out is not None:
                note(f"Results are in {self.out}; there are too many cells for a recording.")
        if self.out is not None and drawn and not has_module("rerun"):
            note(f"No recording is written: {missing_module('rerun')}")


def command_of(study: type[Study], words: str = "") -> Any:
    """Create the class of a study's command; its name is `words`, by default `study.command`."""
    own = {
        "__doc__": study.__doc__,
        # The study itself checks the parameters, after all options have been read.
        "__post_init__": lambda _: None,
        "study": study,
        "command": words or study.command,
    }
    return dataclasses.make_dataclass(
        study.__name__, [], bases=(StudyCommand, study), namespace=own, frozen=True, kw_only=True
    )


STUDY_COMMANDS = {study.command: command_of(study) for study in STUDIES if study.command}
"""The class of the command of each study, by the words after `jaxcell`."""


def read_study(words: Sequence[str]) -> tuple[str, Any] | None:
    """Parse the words of a command that runs a study.

    Returns the name of the command and its options, or `None` for another command.
    """
    two, first = " ".join(words[:2]), " ".join(words[:1])
    if first == "run" and len(words) > 1 and not words[1].startswith("-"):
        from ..study.loading import load_study

        check_addresses("JAX")
        name, kind, rest = two, command_of(load_study(words[1]), two), words[2:]
    else:
        name = two if two in STUDY_COMMANDS else first
        if name not in STUDY_COMMANDS:
            return None
        kind, rest = STUDY_COMMANDS[name], words[len(name.split()) :]
    return name, parsed(kind, name, rest, STUDY_COMMANDS)


def _verified(question: Study, result: Result) -> dict[str, Any]:
    """Compare parts of a result with another method, and return the comparisons as JSON."""
    began = time.perf_counter()
    with status("computing parts again by another method"):
        comparisons = question.verify(result)
    return {
        "agrees": all(comparison.agrees for comparison in comparisons),
        "count": sum(comparison.count for comparison in comparisons),
        "seconds": round(time.perf_counter() - began, 3),
        "comparisons": [comparison.as_json() for comparison in comparisons],
    }


def _report(name: str, verified: dict[str, Any], quiet: bool) -> bool:
    """Report a verification on standard error (`quiet` hides success); return whether it agrees."""
    for comparison in verified["comparisons"]:
        if not comparison["agrees"]:
            note(f"jaxcell {name}: --verify: {comparison['what']}: {comparison['where']}")
    if verified["agrees"] and not quiet:
        note(
            f"Verified: {verified['count']:,} numbers agree with another method, in "
            f"{verified['seconds']:g} s."
        )
    return bool(verified["agrees"])
