"""A table of the kinds and doubts of public files: `python -m experiments.corpus FOLDER`.

`FOLDER` has the repositories of `public.toml`, each cloned as `OWNER/NAME`. A file that is not
there is left out. The table has the exit status of `doctor`, what each file was taken for, and its
doubts.
"""

import argparse
import contextlib
import csv
import io
import json
import tomllib
from pathlib import Path

from jaxcell.cli import main


def said(paths):
    """The exit status of `doctor`, and its words in one line."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        status = main(["doctor", *map(str, paths), "--json"])
    if not out.getvalue():
        return status, "", " ".join(errors.getvalue().split())
    found = json.loads(out.getvalue())
    reports = found if isinstance(found, list) else [found]
    doubts = [doubt for report in reports for doubt in report["doubts"]]
    return status, "; ".join(report["what"] for report in reports), " | ".join(doubts)


def run():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("runs/corpus.csv"))
    options = parser.parse_args()
    corpus = tomllib.loads((Path(__file__).parent / "public.toml").read_text(encoding="utf-8"))
    rows = []
    for repository, files in corpus.items():
        for names in files["files"]:
            paths = [options.folder / repository / name for name in names.split()]
            if all(path.exists() for path in paths):
                rows.append((repository, names, *said(paths)))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([("repository", "files", "exit", "what", "doubts"), *rows])
    for status in sorted({row[2] for row in rows}):
        print(f"{sum(row[2] == status for row in rows)} files with exit status {status}")


if __name__ == "__main__":
    run()
