import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...base.paths import replacing
from ...drift import Dropped, SeaDrift


def save_deployment(drift: Dropped | SeaDrift, path: str | os.PathLike[str]) -> None:
    """Write the cells in which to drop drifters, one per line, as CSV or as GeoJSON (RFC 7946).

    The columns, or properties of the points, are

    - `number`: the number of the drifter, from 1;
    - `lon`, `lat`, `cell`: the position in degrees, and the index of the cell there;
    - `purpose`: `reach` if the drifter is dropped to reach the cells of its group, or `view` if it
        is dropped to see the sea bed;
    - `group`, `transient_group`: the group of the cell; the first column is empty if this group is
        transient, and the second column if it is persistent;
    - `gained`: the number of cells of the group that no earlier drifter reaches.

    Those of a `Dropped` are `number`, `lon`, `lat`, `cell`, and the quantities of its drops: what
    each gains, the shares that are lost, and where to fetch the drifter.

    **Arguments:**

    - `drift`: the result.
    - `path`: the file to write or replace, with a name that ends in `.csv` or `.geojson`.

    **Raises:** `ValueError` if the name has another ending; `FileNotFoundError` if the folder does
    not exist.

    The surface of the bundled sea at the first time in its file:

        >>> from jaxcell import bundled, drift, examples, record
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> sea = drift.SeaDrift.of(currents)
        >>> path = examples.folder() / "deployment.csv"
        >>> record.save_deployment(sea, path)
        >>> path.read_text().splitlines()[0]
        'number,lon,lat,cell,purpose,group,transient_group,gained'
    """
    write = {".csv": _csv, ".geojson": _geojson}.get(Path(path).suffix)
    if write is None:
        raise ValueError(f"{path}: expected a name that ends in .csv or .geojson")
    with replacing(path) as temporary:
        rows = _drops(drift) if isinstance(drift, Dropped) else _rows(drift)
        temporary.write_text(write(rows), encoding="utf-8", newline="")


def _csv(rows: pd.DataFrame) -> str:
    return str(rows.to_csv(index=False, lineterminator="\r\n"))


def _geojson(rows: pd.DataFrame) -> str:
    features = []
    for row in rows.astype(object).where(rows.notna(), None).to_dict("records"):
        point = {"type": "Point", "coordinates": [row.pop("lon"), row.pop("lat")]}
        features.append({"type": "Feature", "geometry": point, "properties": row})
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, indent=1) + "\n"


def _drops(found: Dropped) -> pd.DataFrame:
    columns = {
        "number": np.arange(found.cell.size) + 1,
        "lon": found.drop_lon.round(6) + 0.0,
        "lat": found.drop_lat.round(6) + 0.0,
        "cell": found.cell,
        "gained": found.gained.round(3),
        "stranded": found.stranded,
        "left": found.left,
        "end_lon": found.end_lon.round(6) + 0.0,
        "end_lat": found.end_lat.round(6) + 0.0,
        "end_spread_km": found.end_spread.round(3),
    }
    return pd.DataFrame(columns)


def _rows(drift: SeaDrift) -> pd.DataFrame:
    chosen, begins = drift.deployment, drift.layers[0].begins
    views = np.zeros(0, np.int32) if drift.views is None else drift.views.cells
    cells = np.concatenate([chosen.cells, views])
    lon, lat, _ = np.array(drift.places(cells)).reshape(-1, 3).T
    group, transient = np.asarray(begins.groups.group), np.asarray(begins.transient.group)
    columns = {
        "number": np.arange(cells.size) + 1,
        # Round to about a decimetre, and remove the sign of zeros.
        "lon": lon.round(6) + 0.0,
        "lat": lat.round(6) + 0.0,
        "cell": cells,
        "purpose": ["reach"] * chosen.cells.size + ["view"] * views.size,
        "group": _known(group[cells]),
        "transient_group": _known(transient[cells]),
        "gained": _known(np.append(chosen.gained, np.full(views.size, -1))),
    }
    return pd.DataFrame(columns)


def _known(numbers: np.ndarray) -> pd.Series:
    """Convert numbers to a series with missing values instead of -1."""
    return pd.Series(numbers, dtype="Int64").where(numbers >= 0)
