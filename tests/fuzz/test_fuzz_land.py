"""Damaged files of land."""

import io
import json

import pytest
import shapely
from hypothesis import given
from mutations import cases, changed_json, damaged, place, reads_or_refuses

from jaxcell.drift.currents.land import read_land


ISLAND = shapely.geometry.mapping(shapely.box(-120, 33, -119, 34))
FEATURE = {"type": "Feature", "properties": {"name": "island"}, "geometry": ISLAND}
JSON = {"land.geojson": {"type": "FeatureCollection", "features": [FEATURE, FEATURE]}}


def shapefile_bytes():
    shapefile = pytest.importorskip("shapefile")
    shp, shx, dbf = io.BytesIO(), io.BytesIO(), io.BytesIO()
    with shapefile.Writer(shp=shp, shx=shx, dbf=dbf, shapeType=shapefile.POLYGON) as writer:
        writer.field("name")
        writer.poly([list(map(list, ISLAND["coordinates"][0]))])
        writer.record("island")
    return shp.getvalue()


@cases()
@given(changed_json(JSON))
def test_land_of_geojson_with_errors_is_read_or_refused(tmp_path, change):
    name, content = change
    reads_or_refuses(read_land, place(tmp_path, name, content))


@cases()
@given(damaged({name: json.dumps(document).encode() for name, document in JSON.items()}))
def test_damaged_geojson_is_read_or_refused(tmp_path, change):
    name, content = change
    reads_or_refuses(read_land, place(tmp_path, name, content))


@cases()
@given(damaged({"land.shp": shapefile_bytes()}))
def test_damaged_shapefiles_are_read_or_refused(tmp_path, change):
    name, content = change
    reads_or_refuses(read_land, place(tmp_path, name, content))


def test_the_undamaged_ones_are_read(tmp_path):
    content = json.dumps(JSON["land.geojson"]).encode()
    assert reads_or_refuses(read_land, place(tmp_path, "land.geojson", content))
    assert reads_or_refuses(read_land, place(tmp_path, "land.shp", shapefile_bytes()))
