import contextlib
import dataclasses
import json
import shlex
from pathlib import Path
from typing import Any, ClassVar

import tyro

from .. import sweep
from ..base.documents import NewerVersionError
from ..base.paths import digest
from ..base.results import MANIFEST, Manifest, interrupted, repeating, result_folder, versions
from ..sweep.storage.journal import JOURNAL
from .output import Printing
from .startup import prepare_tasks
from .study_command import read_study
from .terminal import note, own_command, say, status, stdout_on_stderr, table


_MAX_LISTED = 10


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verify(Printing):
    """Check results and sweeps for damage and for mixed runs, without running their code.

    Exit status: 0 everything is intact or mended, 1 something is damaged, 2 bad input."""

    example: ClassVar[str] = "runs/lab"

    folder: tyro.conf.Positional[Path]
    """Folder of a result or a sweep, or a folder with such folders."""
    mend: bool = False
    """Compute damaged results and damaged chunks of sweeps again, with the options and input files
    of their run. This runs the user's own studies, systems and tasks that they name."""
    engine: str = "local"
    """Engine for the chunks of sweeps: local, processes, dask, or dask://host:port."""
    workers: int | None = None
    """Number of worker processes if --engine is processes or dask; by default one per processor."""

    def run(self) -> int:
        with stdout_on_stderr(), status(f"reading {self.folder}"):
            reports = [
                self._sweep(folder) if (folder / JOURNAL).exists() else self._result(folder)
                for folder in _results_in(self.folder)
            ]
        whole = all(report["whole"] for report in reports)
        if self.json:
            say(json.dumps({"folder": str(self.folder), "whole": whole, "results": reports}))
            return 0 if whole else 1
        rows = [
            (report["folder"], report["checked"], len(report["damaged"]), report["mended"])
            for report in reports
        ]
        table(str(self.folder), ("result", "files or chunks", "damaged", "mended"), rows)
        for report in reports:
            for line in report["damaged"][:_MAX_LISTED]:
                note(f"damaged: {report['folder']}: {line}")
            if (more := len(report["damaged"]) - _MAX_LISTED) > 0:
                note(f"... and {more:,} others")
            if unlisted := report["unlisted"]:
                listed = ", ".join(unlisted[:_MAX_LISTED])
                listed += ", ..." * (len(unlisted) > _MAX_LISTED)
                note(f"{report['folder']}: not checked, because not of this result: {listed}")
            for way in report["ways"]:
                note(f"{report['folder']}: {way}")
        return 0 if whole else 1

    def _sweep(self, folder: Path) -> dict[str, Any]:
        if self.mend:
            prepare_tasks()
        checked = sweep.verify_sweep(
            folder, mend=self.mend, engine=self.engine, workers=self.workers
        )
        return {
            "folder": str(folder),
            "checked": checked.chunks,
            "damaged": list(checked.damaged),
            "unlisted": [],
            "mended": checked.recomputed,
            "whole": checked.whole,
            "ways": [] if checked.whole or self.mend else [_mending(folder)],
        }

    def _result(self, folder: Path) -> dict[str, Any]:
        damage, mended, ways, unlisted = [], 0, [], []
        if interrupted(folder):
            damage.append("a run was interrupted while it replaced the files")
            if self.mend:
                with result_folder(folder):  # Completes the replacement.
                    mended = 1
            else:
                ways.append(_mending(folder))
        try:
            manifest = Manifest.read(folder)
        except NewerVersionError:
            raise
        except ValueError as error:
            manifest = None
            damage.append(str(error))
            ways.append(
                f"its other files were not checked, because their digests are in {MANIFEST}; to "
                f"replace the result, run its command again with --out {folder}"
            )
        if manifest is not None:
            strangers = manifest.strangers(folder)
            lost = [name for name in manifest.damage(folder) if name not in strangers]
            damage += lost + strangers
            if lost and manifest.words[:1] == ["robot"]:
                ways.append(_robot_again(folder, manifest, lost))
            elif lost and self.mend:
                _compute_again(folder, manifest)
                mended += len(lost)
            elif lost:
                ways.append(_mending(folder))
            unlisted = [name for name in manifest.unlisted(folder) if name not in strangers]
            if strangers:
                ways.append(f"move the files of another run elsewhere: {', '.join(strangers)}")
        return {
            "folder": str(folder),
            "run_id": None if manifest is None else manifest.run_id,
            "checked": 0 if manifest is None else len(manifest.files),
            "damaged": damage,
            "unlisted": unlisted,
            "mended": mended,
            "whole": mended == len(damage),
            "ways": list(dict.fromkeys(ways)),
        }


def _results_in(folder: Path) -> list[Path]:
    """Return the folders of the results and sweeps in a folder and its subfolders."""
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder}: there is no such folder")
    marks = (*folder.rglob(MANIFEST), *folder.rglob(JOURNAL))
    # The manifest of an interrupted run is in a hidden folder of the result.
    folders = {
        mark.parent.parent if mark.parent.name.startswith(".") else mark.parent for mark in marks
    }
    if not folders:
        raise ValueError(
            f"{folder}: expected the folder of a result, with a {MANIFEST}, or of a sweep, with a "
            f"{JOURNAL}"
        )
    return sorted(folders)


def _compute_again(folder: Path, manifest: Manifest) -> None:
    """Run the command of a result again, from the folder in which its inputs have their names."""

    def has_inputs(place: Path) -> bool:
        names = ((place / name, old) for name, old in manifest.inputs.items() if name[0] != "@")
        return all(path.is_file() and digest(path) == old for path, old in names)

    folder = folder.resolve()
    places = (Path.cwd(), *folder.parents)
    with contextlib.chdir(next(filter(has_inputs, places), places[0])):
        _compute_here(folder, manifest)


def _compute_here(folder: Path, manifest: Manifest) -> None:
    read = read_study([*manifest.words, "--out", str(folder), "--json"])
    assert read is not None
    _, command = read
    again = shlex.join(["jaxcell", *manifest.words])
    inputs = command.question.digests()
    changed = [name for name, old in manifest.inputs.items() if inputs.get(name) != old]
    if changed:
        raise ValueError(
            f"{folder}: damaged, and its input {', '.join(changed)} has changed since; "
            f"to compute another result: {again} --out {shlex.quote(str(folder))}"
        )
    here = versions()
    others = [
        f"{name} {old} then, {here.get(name)} now"
        for name, old in manifest.versions.items()
        if here.get(name) != old
    ]
    if others:
        note(f"{folder}: computed again with other versions: {'; '.join(others)}")
    # A robot's log has the digest of its filter, which has the identifier of the run.
    with contextlib.nullcontext() if others else repeating(manifest.run_id):
        command.run()


def _mending(folder: Path) -> str:
    return f"to compute it again: {own_command('verify', '--mend', folder)}"


def _robot_again(folder: Path, manifest: Manifest, lost: list[str]) -> str:
    """Describe how to get the damaged files of a run of a robot again."""
    from .robot.outcome import LOG

    if LOG in lost:
        return (
            f"only another run gives its log again: {own_command(*manifest.words, '--out', 'NEW')}"
        )
    replay = own_command("robot", "replay", folder / LOG, "--out", "NEW")
    return f"its log is whole and gives the other files again: {replay}"
