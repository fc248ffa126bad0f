"""Map files of all formats, damaged."""

import io
import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from mutations import DATA, cases, changed_json, damaged, limits, place, reads_or_refuses
from PIL import Image

from jaxcell.space import Workspace


MAPS = {path.name: path.read_bytes() for path in (DATA / "maps").glob("*.*")}
JSON = {
    name: json.loads(content)
    for name, content in MAPS.items()
    if name in ("arena.json", "lab_a.json", "complex.json")
}
SMALL = {
    "m.json": MAPS["lab_a.json"],
    "n.json": b'{"format": "jaxcell-map", "version": 1, "units": "ft", "boundary": '
    b'[[0, 0], [6, 0], [0, 5]], "robot_radius": 0.17, "cell": 0.25, "directions": 16}',
    "m.txt": b"; name a corridor\n; cell 0.25\n; origin 1 2\n; robot_radius 0.1\n; directions 8\n"
    b";; a remark\n#######\n#..#..#\n#.....#\n#######\n",
    "n.map": b"...\n.#.\n...\n",
}
YAML = (
    b"image: m.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n"
    b"occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
)


def image(form, mode="L"):
    pixels = np.full((5, 7), 254, np.uint8)
    pixels[1:3, 2] = 0
    file = io.BytesIO()
    Image.fromarray(pixels).convert(mode).save(file, form)
    return file.getvalue()


IMAGES = {
    "m.pgm": image("PPM"),
    "plain.pgm": b"P2\n# by hand\n3 2\n255\n255 0 255\n254 254 254\n",
    "m.png": image("PNG"),
    "rgba.png": image("PNG", "RGBA"),
    "palette.png": image("PNG", "P"),
    "two.png": image("PNG", "1"),
}


@cases()
@given(changed_json(JSON))
def test_json_maps(tmp_path, file):
    reads_or_refuses(Workspace.load, place(tmp_path, *file))


@cases()
@given(damaged(SMALL))
def test_maps_of_text(tmp_path, file):
    reads_or_refuses(Workspace.load, place(tmp_path, *file))


@cases()
@given(damaged({"m.yaml": YAML}))
def test_map_server_descriptions(tmp_path, file):
    place(tmp_path, "m.pgm", IMAGES["m.pgm"])
    reads_or_refuses(Workspace.load, place(tmp_path, *file))


@cases()
@given(damaged(IMAGES))
def test_map_server_images(tmp_path, file):
    name, content = file
    place(tmp_path, name, content)
    description = place(tmp_path, "m.yaml", YAML.replace(b"m.pgm", name.encode()))
    reads_or_refuses(Workspace.load, description)


def test_the_undamaged_ones_are_read(tmp_path):
    for name, content in {**SMALL, **IMAGES}.items():
        place(tmp_path, name, content)
    for name in SMALL:
        assert reads_or_refuses(Workspace.load, tmp_path / name)
    for name in IMAGES:
        yaml = place(tmp_path, "m.yaml", YAML.replace(b"m.pgm", name.encode()))
        assert reads_or_refuses(Workspace.load, yaml)
    for name in JSON:
        assert reads_or_refuses(Workspace.load, DATA / "maps" / name)


@pytest.mark.parametrize(
    ("size", "said"),
    [
        ("1000000000 1000000000", r"too large: .*1000000000000000000 pixels"),
        ("30000 30000", r"too large: .*900000000 pixels"),
        ("9000 9000", "broken or cut short"),
        ("0 5", "image: m.pgm: "),
        ("-1 5", "image: m.pgm: "),
    ],
)
def test_images_that_claim_to_be_huge(tmp_path, size, said):
    place(tmp_path, "m.pgm", f"P5\n{size}\n255\n".encode() + b"\0" * 50)
    path = place(tmp_path, "m.yaml", YAML)
    with limits(), pytest.raises(ValueError, match=said):
        Workspace.load(path)


def test_a_yaml_of_a_billion_laughs(tmp_path):
    text = "l0: &l0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
        f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]\n" for i in range(1, 12)
    )
    for field in (b"origin", b"image", b"negate", b"resolution", b"mode", b"free_thresh"):
        start = YAML.index(field)
        line = YAML[start : YAML.index(b"\n", start)]
        path = place(tmp_path, "m.yaml", text.encode() + YAML.replace(line, field + b": *l11"))
        assert not reads_or_refuses(Workspace.load, path)


@given(
    st.sampled_from([b"", b"\n", b"; cell 1", b"#", b"{}", b"[]", b"null", b"0", b"\xef\xbb\xbf"])
)
def test_hardly_anything(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("little")
    for name in ("a.json", "a.txt", "a.map", "a.yaml", "a.yml", "a.pgm", "a.png"):
        assert not reads_or_refuses(Workspace.load, place(folder, name, content))
