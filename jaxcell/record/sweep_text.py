"""What a stranger reads beside the pictures of a sweep, in Markdown."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from .sweep_axes import Axis
from .texts import made_with


_MOST_FAILURES = 20
_MOST_LETTERS = 80


def sweep_text(
    dataset: xr.Dataset,
    found: Sequence[Axis],
    ranges: Mapping[str, tuple[float, float, int]],
    left_out: Sequence[str],
    failures: Sequence[str],
) -> str:
    """What the recording of a sweep shows.

    **Arguments:**

    - `dataset`: the result.
    - `found`: its axes.
    - `ranges`: of each variable that is shown the least and the greatest value, and how many values
        are not finite.
    - `left_out`: the variables that are not shown.
    - `failures`: what failed, a line each.
    """
    status = dataset["status"]
    sizes = " x ".join(f"{status.sizes[name]:,} {name}" for name in status.dims)
    parts = [
        f"# {dataset.attrs.get('title', 'Sweep')}",
        f"A task was run for **{status.size:,} members** ({sizes}). {_states(status.values)}",
        f"""## How to look

A tab is a variable. Each parameter is a timeline: choose one at the bottom left, and press play or
drag the slider.

{_axes(found)}

- **Above**: the variable along the parameter whose timeline is chosen: its median, quartiles, least
  and greatest value among the members that share the value of the parameter, over all values of the
  others. Where members are alone there is one line.
- **Below**: its mean over pairs of parameters, from dark blue (small) to yellow, in equal ratios
  where these are large. Grey squares have no member that is done; the white line is where the
  slider is. Hover over a square to read it.

One member in detail: `jaxcell sweep view FOLDER --select NAME=VALUE ...`""",
        f"## Variables\n\n{_variables(dataset, ranges)}",
    ]
    if left_out:
        parts.append(
            "Not shown, for they are more than a number for each member, or too many: "
            + ", ".join(f"`{name}`" for name in left_out)
            + "."
        )
    if failures:
        lines = [f"- {one}" for one in failures[:_MOST_FAILURES]]
        if len(failures) > _MOST_FAILURES:
            lines.append(f"- and {len(failures) - _MOST_FAILURES:,} others")
        parts.append("## Failures\n\n" + "\n".join(lines))
    parts.append(made_with(_made(dataset.attrs)))
    return "\n\n".join(parts)


def _states(states: np.ndarray) -> str:
    failed, undone = int((states == 2).sum()), int((states == 0).sum())
    if not failed and not undone:
        return "All are done."
    told = [f"{int((states == 1).sum()):,} are done"]
    told += [f"**{failed:,} failed**"] * (failed > 0)
    told += [f"**{undone:,} are not computed yet**"] * (undone > 0)
    return ", ".join(told) + "."


def _axes(found: Sequence[Axis]) -> str:
    lines = ["| timeline | a time is | from | to |", "| --- | --- | --- | --- |"]
    for axis in found:
        ends = f"{axis.labels[0]} | {axis.labels[-1]}"
        lines.append(f"| `{axis.timeline}` | {axis.told} | {ends} |")
    return "\n".join(lines)


def _variables(dataset: xr.Dataset, ranges: Mapping[str, tuple[float, float, int]]) -> str:
    lines = ["| variable | least | most | meaning |", "| --- | --- | --- | --- |"]
    for name, (least, most, infinite) in ranges.items():
        about = dataset[name].attrs
        meaning = str(about.get("long_name", ""))
        if (unit := about.get("units", "1")) != "1":
            meaning += f", in {unit}" if meaning else f"in {unit}"
        if infinite:
            meaning += f" (not finite, and not shown, for {infinite:,} members)"
        lines.append(f"| `{name}` | {least:.6g} | {most:.6g} | {meaning} |")
    return "\n".join(lines)


def _made(attributes: Mapping[str, Any]) -> dict[str, str]:
    """The specification field by field, and what it was run with."""
    made: dict[str, str] = {}
    spec = json.loads(attributes.get("spec", "{}"))
    for field, value in spec.items():
        inner = value if isinstance(value, dict) else None
        for name, one in {field: value}.items() if inner is None else inner.items():
            text = json.dumps(one)
            text = text if len(text) <= _MOST_LETTERS else text[: _MOST_LETTERS - 4] + " ..."
            made[name if inner is None else f"{field}.{name}"] = text
    for name in ("jaxcell_version", "jax_version", "jax_enable_x64", "git_revision"):
        if name in attributes:
            made[name] = str(attributes[name])
    return made
