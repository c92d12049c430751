"""Makes ``shipped.npz``: the convex pieces and sphere covers of every robot of the catalogue, so that no one waits for them.

    python -m energyopt.geometry.ship

To be run where `cache.VERSION` was raised, or a robot added; a test says so.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from energyopt.geometry import cache
from energyopt.geometry.robot_spheres import robot_spheres
from energyopt.robots import load_robot
from energyopt.robots.catalogue import catalogue

KINDS = ("mesh", "cover")


def main() -> None:
    """Compute everything anew, in an empty cache, and write the archive."""
    cache.SHIPPED.unlink(missing_ok=True)
    cache.shipped_archive.cache_clear()
    with tempfile.TemporaryDirectory() as folder:
        cache.cache_folder = lambda: Path(folder)
        for name in catalogue():
            print(f"{name}: {robot_spheres(load_robot(name)).summary()}", flush=True)
        arrays = {}
        for path in sorted(Path(folder).glob("*.npz")):
            if path.name.split("-")[0] in KINDS:
                with np.load(path, allow_pickle=False) as archive:
                    arrays |= {f"{path.stem}/{key}": archive[key] for key in archive.files}
        np.savez_compressed(cache.SHIPPED, **arrays)
    print(f"{cache.SHIPPED}: {len(arrays)} arrays, {cache.SHIPPED.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
