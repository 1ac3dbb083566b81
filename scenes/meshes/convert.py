"""Convert an ASCII PLY scan, gzipped or not, to the compact binary PLY that the scenes load.

    python convert.py SOURCE.ply[.gz] OUT.ply

Positions are kept as float32, triangles as uint32, both in the scan's order, units and
orientation; scenes place a mesh with `to_world`. Dropped are the scan's confidence and intensity,
back-to-back triangles (see `without_flaps`) and vertices that no triangle uses. Vertex normals are
not stored: Mitsuba computes them at load.
"""

import argparse
import gzip
import sys
from pathlib import Path

import numpy as np


def read_ascii_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) float32 and triangles (m, 3) uint32; `path` may end in `.gz`."""
    data = path.read_bytes()
    lines = (gzip.decompress(data) if path.suffix == ".gz" else data).decode("ascii").splitlines()
    if lines[:2] != ["ply", "format ascii 1.0"]:
        raise ValueError(f"{path}: expected an ASCII PLY file")
    end = lines.index("end_header")
    counts = {line.split()[1]: int(line.split()[2]) for line in lines[:end] if "element" in line}
    properties = [line.split()[-1] for line in lines[:end] if line.startswith("property")]
    if list(counts) != ["vertex", "face"] or properties[:3] != ["x", "y", "z"]:
        raise ValueError(f"{path}: expected vertices that begin with x, y, z, and then faces")

    first_face = end + 1 + counts["vertex"]
    positions = np.loadtxt(lines[end + 1 : first_face], np.float32, usecols=(0, 1, 2))
    faces = np.loadtxt(lines[first_face : first_face + counts["face"]], np.uint32, ndmin=2)
    if faces.shape[1] != 4 or (faces[:, 0] != 3).any():
        raise ValueError(f"{path}: expected triangles only")
    return positions, faces[:, 1:]


def without_flaps(triangles: np.ndarray) -> np.ndarray:
    """The triangles without those that cover each other, front against back.

    The dragon's decimation left some. They enclose nothing, and where a vertex has no other
    triangles its normal is zero, of which Mitsuba warns at every load. Of several triangles on the
    same three vertices one stays if the fronts and backs do not balance, so a closed mesh remains
    closed.
    """
    a, b, c = triangles.astype(np.int64).T
    orientation = np.sign((b - a) * (c - b) * (a - c))  # of the order of its vertices' numbers
    _, group = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True)
    group = group.ravel()
    balance = np.bincount(group, orientation)[group]
    kept = np.flatnonzero(orientation * balance > 0)
    _, first = np.unique(group[kept], return_index=True)
    return triangles[np.sort(kept[first])]


def without_unused(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same mesh without the vertices that no triangle refers to."""
    used, renumbered = np.unique(triangles, return_inverse=True)
    return positions[used], renumbered.reshape(-1, 3)


def write_binary_ply(path: Path, positions: np.ndarray, triangles: np.ndarray) -> None:
    """Little-endian binary PLY with positions and triangles alone."""
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("vertices", "<u4", 3)])
    faces["count"], faces["vertices"] = 3, triangles
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(positions)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\n"
        "property list uchar uint vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode("ascii") + positions.astype("<f4").tobytes() + faces.tobytes())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path, help="ASCII PLY file, gzipped or not")
    parser.add_argument("out", type=Path, help="binary PLY file to write")
    arguments = parser.parse_args()

    try:
        positions, triangles = read_ascii_ply(arguments.source)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
    positions, triangles = without_unused(positions, without_flaps(triangles))
    write_binary_ply(arguments.out, positions, triangles)
    print(f"{arguments.out}: {len(positions)} vertices, {len(triangles)} triangles")
    print(f"bounds {positions.min(axis=0)} to {positions.max(axis=0)}")


if __name__ == "__main__":
    main()
