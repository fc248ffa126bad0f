import json
import os

import numpy as np
import shapely
import shapely.affinity

from ...base.paths import replacing
from ...currents.sphere import wrapped
from ...drift import Released
from ...drift.positions import in_degrees
from ...drift.regions import TURNS
from ...drift.released_drifters import likely


_PARTS = (0.5, 0.9)
_WORLD = shapely.box(-180.0, -90.0, 180.0, 90.0)
# The corners of a square in cells from its centre, a little inside, so that they belong to it.
_CORNERS = 0.4999999 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]])


def save_release(found: Released, path: str | os.PathLike[str]) -> None:
    """Write where the drifters of a release are, as polygons of GeoJSON (RFC 7946).

    A feature per time and part has the fewest cells that have half, or nine tenths, of the drifters
    on the map, cut at 180 degrees of longitude. Its properties are `hours` after the release
    (negative: before the find), the `date`, and the `probability`.

    **Arguments:**

    - `found`: the result.
    - `path`: the file to write or replace.

    **Raises:** `FileNotFoundError` if the folder does not exist.

    The surface of the bundled sea:

        >>> from jaxcell import examples, record, study
        >>> spill = study.Release(file="@gyres", start="-117.93,33.5", until=0.1, precision=0.1)
        >>> found = spill.run()
        >>> path = examples.folder() / "release.geojson"
        >>> record.save_release(found, path)
        >>> path.read_text()[:27]
        '{"type": "FeatureCollection'
    """
    features, water = [], found.water
    way = 1 if found.tried is None else -1
    dates = [None] * found.hours.size if found.date is None else found.date.tolist()
    for row, (hours, date) in enumerate(zip(found.hours.tolist(), dates, strict=True)):
        share = np.nan_to_num(found.share[row])[water.row, water.column]
        for part in _PARTS:
            chosen = likely(share, part)
            x, y = (
                place[chosen][:, None] + off
                for place, off in zip((water.column, water.row), _CORNERS, strict=True)
            )
            lon, lat = in_degrees(water, x, y)
            middle = water.lon[water.row[chosen], water.column[chosen]][:, None]
            lon = middle + wrapped(lon - middle)
            shape = _cut(shapely.polygons(np.stack([lon, lat], axis=-1).round(5)))
            properties = {
                "hours": way * hours,
                "date": date,
                "probability": float(share[chosen].sum()),
            }
            geometry = shapely.geometry.mapping(shape)
            features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    with replacing(path) as temporary:
        collection = {"type": "FeatureCollection", "features": features}
        temporary.write_text(json.dumps(collection) + "\n", encoding="utf-8")


def _cut(cells: np.ndarray) -> shapely.Geometry:
    """Unite cells in degrees, and cut what is beyond 180 degrees of longitude to the other side."""
    whole = shapely.union_all(cells)
    turned = [
        shapely.transform(whole, lambda at, by=turn: at + np.array([by, 0.0])) for turn in TURNS
    ]
    parts = shapely.get_parts(shapely.intersection(turned, _WORLD))
    return shapely.union_all(parts[shapely.area(parts) > 0])
