"""Write the sample data of ``data/``: ``python -m fdd.plant.samples [FOLDER]`` gives the same bytes every time."""

from __future__ import annotations

import gzip
import hashlib
import sys
from pathlib import Path

from rich.console import Console

from fdd.plant.faults import DAY, PlantFault
from fdd.plant.scenario import Scenario, simulate
from fdd.plant.site import demo_site

FOULING = Scenario(days=42, seed=2024, faults=(PlantFault("fouling", "hx", 28 * DAY, 0.25, "ramp", 10 * DAY),))


def write_samples(folder: Path) -> dict[str, str]:
    """Write every sample and its site file; returns file names with their SHA-256."""
    folder.mkdir(parents=True, exist_ok=True)
    frame = simulate(FOULING)
    # A digit or two below the sensors' errors.
    frame = frame.round({c: 5 if "m_flow" in str(c) else 3 for c in frame.columns})
    text = frame.to_csv(lineterminator="\n", date_format="%Y-%m-%dT%H:%M:%SZ")
    path = folder / "house_fouling.csv.gz"
    # No name and no time in the header, so that the file depends on its content alone.
    path.write_bytes(gzip.compress(text.encode(), compresslevel=9, mtime=0))
    source = {"kind": "csv", "path": path.name}
    site = demo_site(folder, name="house", sources=[source])
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in (path, site)}


def main() -> None:
    """Write the samples and print their checksums."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2] / "data"
    for name, checksum in write_samples(folder).items():
        Console().print(f"{checksum}  {folder / name}")


if __name__ == "__main__":
    main()
