"""Move drifters by Parcels 3, for `bench_particles.py`.

    python parcels_drifters.py IN.npz OUT.npz

The script runs in an environment of its own, because Parcels 3 needs zarr 2, and jaxcell zarr 3.
"""

import sys
import time

import numpy as np
import parcels


def main(given: str, out: str) -> None:
    data = np.load(given)
    current = parcels.FieldSet.from_data(
        {name: data[name].astype(np.float32) for name in "UV"},
        {name: data[name] for name in ("lon", "lat", "time")},
        mesh="flat",
    )
    kernel, seconds = None, 0.0
    # The first run compiles.
    for part in (slice(100), slice(None)):
        places = {"lon": data["x"][part], "lat": data["y"][part]}
        particles = parcels.ParticleSet(
            current, parcels.JITParticle, **places, lonlatdepth_dtype=np.float64
        )
        kernel = kernel or particles.Kernel(parcels.AdvectionRK4)
        began = time.perf_counter()
        particles.execute(
            kernel, runtime=float(data["end"]), dt=float(data["step"]), verbose_progress=False
        )
        seconds = time.perf_counter() - began
    np.savez(out, x=particles.lon, y=particles.lat, seconds=seconds)


if __name__ == "__main__":
    main(*sys.argv[1:])
