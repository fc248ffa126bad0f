"""Check the strategies of the bench of patrolling games, bound their values, and write the table.

    python -m experiments.patrolling_bench

Each strategy is evaluated by `value.py`, which shares nothing with jaxcell; the bounds are those of
jaxcell. The table replaces the one of `docs/pages/patrolling_bench.md`; names of games renew their
rows alone. `--check NAME` prints the value of one strategy, or of the file `--strategy`, and its
bound. `--search NAME` searches for a strategy, and keeps it if it is better.
"""

import argparse
import json
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

from jaxcell.base.runtime import configure_jax

from ..shared.report import tracked
from . import search
from .value import shares, value


HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "pages" / "patrolling_bench.md"
MARKS = "<!-- table -->\n", "<!-- /table -->"
# Values that differ by less are the same; tolerance of a prescribed share.
SAME, SHARE = 1e-6, 1e-6
# Tests of the upper bound of a walk, unless the instance says otherwise.
TESTS = 6
HEAD = """| game | vertices, attack | robots, adversary | known | found | bound | by, seconds |
|---|---|---|--:|--:|--:|---|
"""


def instances() -> list[dict[str, Any]]:
    return tomllib.loads((HERE / "instances.toml").read_text(encoding="utf-8"))["instance"]


def game_of(name: str) -> Path:
    return HERE / "games" / f"{name}.json"


def strategy_of(name: str) -> Path:
    return HERE / "strategies" / f"{name}.json"


def read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def found(instance: dict[str, Any], path: Path) -> float:
    """Compute the value of a strategy, and check prescribed shares."""
    game, strategy = read(game_of(instance["name"])), read(path)
    if wanted := instance.get("shares"):
        given = shares(game, strategy["walk"])
        away = max(abs(a - b) for a, b in zip(given.values(), wanted, strict=True))
        if away > SHARE:
            raise ValueError(f"{path}: a share of moves is {away:.2g} from the prescribed one")
    return value(game, strategy)


def limit_of(instance: dict[str, Any]) -> float:
    """Compute an upper bound on the value of all strategies of a game."""
    path, tests = game_of(instance["name"]), instance.get("tests", TESTS)
    return search.bound(path, instance.get("memory"), tests)


def row(instance: dict[str, Any]) -> str:
    """Make the row of an instance in the table."""
    name = instance["name"]
    game, strategy = read(game_of(name)), read(strategy_of(name))
    best = found(instance, strategy_of(name))
    limit = limit_of(instance)
    text = "optimal" if limit - best < SAME else f"{limit:.4f}"
    times = sorted({target["attack_time"] for target in game["targets"]})
    attack = " and ".join(f"{time:g}" for time in times)
    cells = [
        f"`{name}`",
        f"{len(game['vertices'])}, {attack} {game['unit']}",
        f"{game['robots']}, {game['adversary']}",
        f"{instance['known']} ({instance['source']})" if "known" in instance else "",
        f"{best:.4f}",
        text,
        f"{strategy['by']}, {strategy['seconds']:g}",
    ]
    return f"| {' | '.join(cells)} |\n"


def improve(instance: dict[str, Any]) -> None:
    """Search for a strategy, and keep it if it is better than the one of the bench."""
    path = strategy_of(instance["name"])
    before = found(instance, path) if path.exists() else -1.0
    new = path.with_suffix(".new")
    search.save(search.search(game_of(instance["name"]), instance), new)
    after = found(instance, new)
    better = after > before + SAME
    new.replace(path) if better else new.unlink()
    print(f"{instance['name']}: {after:.6f}, {'kept' if better else f'not above {before:.6f}'}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = {instance["name"]: instance for instance in instances()}
    parser.add_argument("names", nargs="*", metavar="NAME", help="rows to renew; by default all")
    parser.add_argument("--check", choices=known, metavar="NAME", help="a game to check")
    parser.add_argument("--strategy", type=Path, help="a file in place of the bench's, to check")
    parser.add_argument(
        "--search", choices=known, metavar="NAME", nargs="+", help="games to search"
    )
    options = parser.parse_args()
    configure_jax()
    if options.check:
        instance = known[options.check]
        best = found(instance, options.strategy or strategy_of(options.check))
        limit = limit_of(instance)
        print(f"{options.check}: value {best:.6f}, bound {limit:.6f}")
    elif options.search:
        for name in options.search:
            improve(known[name])
    else:
        began = time.perf_counter()
        before, rest = PAGE.read_text(encoding="utf-8").split(MARKS[0])
        rows, after = rest.split(MARKS[1])
        kept = {line.split("`")[1]: line + "\n" for line in rows.splitlines() if "`" in line}
        renewed = options.names or known
        kept |= {name: row(known[name]) for name in tracked(renewed, "games")}
        text = HEAD + "".join(kept[name] for name in known)
        PAGE.write_text(before + MARKS[0] + text + MARKS[1] + after, encoding="utf-8")
        print(f"{len(renewed)} games; {time.perf_counter() - began:.0f} s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
