"""Write gdp.npz: the moves of the drifters of the Global Drifter Program between hexagons.

The counts are in the wheel of driftmlp 1.2; the package h3 gives the centres of its cells. Both are
downloaded from PyPI to a temporary folder, and not installed. Run `python data/ocean/make_gdp.py`.
"""

import hashlib
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np


WHEEL = "driftmlp-1.2-py3-none-any.whl"
SHA256 = "d55788885b73dbe66fd50e64e882135ab7a43b7dc8ccc8c02dcf9f0b1b3f6e25"
GRAPH = "driftmlp/data/transition_both.GraphML"
H3 = "h3==4.3.1"


def main() -> None:
    """Download the counts, check them, and write them beside this script."""
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "--quiet"]
        wheel, h3 = ["download", "driftmlp==1.2"], ["install", H3, "--target", folder]
        for command in wheel, h3:
            subprocess.run([*pip, *command, "--no-deps"], cwd=folder, check=True)
        found = hashlib.sha256((Path(folder) / WHEEL).read_bytes()).hexdigest()
        if found != SHA256:
            raise SystemExit(f"{WHEEL}: expected the SHA-256 {SHA256}, got {found}")
        text = zipfile.ZipFile(Path(folder) / WHEEL).read(GRAPH).decode()
        sys.path.insert(0, folder)
        np.savez_compressed(Path(__file__).with_name("gdp.npz"), **read(text))


def read(text: str) -> dict[str, np.ndarray]:
    """Read the cells, sorted by their H3 index, and the moves between them from GraphML."""
    import h3

    name = np.array(re.findall(r'<data key="v_name">(\d+)<', text), np.uint64)
    one = r"<data key=\"e_{}\">([^<]+)</data>\s*"
    edges = re.findall(
        r'<edge source="n(\d+)" target="n(\d+)">\s*' + one.format("prob") + one.format("N"), text
    )
    begin, end, share, count = np.array(edges, float).T
    number = np.argsort(np.argsort(name))
    begin, end = number[begin.astype(int)], number[end.astype(int)]
    name = np.sort(name)
    # Moves into cells that were removed, at Panama and Gibraltar, are in the shares only.
    every = np.zeros(name.size)
    every[begin] = np.rint(count / share)
    lost = every - np.bincount(begin, count, name.size)
    at = np.lexsort((end, begin))
    places = [h3.cell_to_latlng(h3.int_to_str(int(one))) for one in name]
    lat, lon = np.array(places).round(4).T
    return {
        "lon": lon.astype(np.float32),
        "lat": lat.astype(np.float32),
        "h3": name,
        "indptr": np.searchsorted(begin[at], np.arange(name.size + 1)).astype(np.int32),
        "indices": end[at].astype(np.uint16),
        "data": count[at].astype(np.uint16),
        "lost": lost.astype(np.uint16),
        "days": np.array(5.0),
    }


if __name__ == "__main__":
    main()
