"""Deployment cells in files that other programs read."""

import csv
import json
import os
from typing import Any

import numpy as np

from ...base.files import replacing
from ...drift import SeaDrift


def save_deployment_csv(drift: SeaDrift, path: str | os.PathLike[str]) -> None:
    """Write the deployment cells as CSV with a head, one drifter a line.

    The columns are `number`, from 1; `lon` and `lat` in degrees; `cell`; `purpose`, which is
    `reach` for a cell of the deployment and `view` for one from where the sea bed is seen;
    `group`, its persistent group, and `transient_group`, of which one is empty; and `gained`, the
    cells that are reached first from there.

    **Arguments:**

    - `drift`: what was found.
    - `path`: the file to write or replace.

    **Raises:** `FileNotFoundError` if the folder does not exist.

    The surface of the bundled sea at its first record:

        >>> import pathlib, tempfile
        >>> from jaxcell import bundled, drift, record
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> found = drift.SeaDrift.of(currents)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "deployment.csv")
        ...     record.save_deployment_csv(found, path)
        ...     path.read_text().splitlines()[0]
        'number,lon,lat,cell,purpose,group,transient_group,gained'
    """
    rows = _rows(drift)
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def save_deployment_geojson(drift: SeaDrift, path: str | os.PathLike[str]) -> None:
    """Write the deployment cells as GeoJSON (RFC 7946), a point for each drifter.

    The properties are those of [`jaxcell.record.save_deployment_csv`][], without the place.

    **Arguments:**

    - `drift`: what was found.
    - `path`: the file to write or replace.

    **Raises:** `FileNotFoundError` if the folder does not exist.

    The surface of the bundled sea at its first record:

        >>> import json, pathlib, tempfile
        >>> from jaxcell import bundled, drift, record
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> found = drift.SeaDrift.of(currents)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "deployment.geojson")
        ...     record.save_deployment_geojson(found, path)
        ...     written = json.loads(path.read_text())
        >>> written["type"], len(written["features"]) == len(found.deployment.cells)
        ('FeatureCollection', True)
    """
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [row.pop("lon"), row.pop("lat")]},
            "properties": row,
        }
        for row in _rows(drift)
    ]
    collection = {"type": "FeatureCollection", "features": features}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(collection, indent=1) + "\n", encoding="utf-8")


def _rows(drift: SeaDrift) -> list[dict[str, Any]]:
    found, behaviour = drift.deployment, drift.layers[0].behaviour
    views = np.zeros(0, np.int32) if drift.views is None else drift.views.cells
    cells = np.concatenate([found.cells, views])
    group, transient = np.asarray(behaviour.groups.group), np.asarray(behaviour.transient.group)
    gained = [*found.gained.tolist(), *(None for _ in views)]
    return [
        {
            "number": number + 1,
            # A decimetre is more than enough.
            "lon": round(lon, 6),
            "lat": round(lat, 6),
            "cell": cell,
            "purpose": "reach" if number < found.cells.size else "view",
            "group": of if of >= 0 else None,
            "transient_group": part if part >= 0 else None,
            "gained": gained[number],
        }
        for number, (cell, (lon, lat, _), of, part) in enumerate(
            zip(
                cells.tolist(),
                drift.places(cells),
                group[cells].tolist(),
                transient[cells].tolist(),
                strict=True,
            )
        )
    ]
