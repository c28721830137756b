"""PLY files: a coloured mesh, and Gaussian splats in the layout of their authors' code (Kerbl et al. 2023)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.nerf.shown.solid import Mesh
from pixelid.nerf.shown.splats import Splats

# For theirs, in their order, the indices of ours (`harmonics`) and the signs.  Viewers expect three degrees or none.
ORDER, SIGNS = (1, 2, 0, 3, 4, 6, 5, 7), (-1, 1, -1, 1, -1, 1, -1, 1)
THREE_DEGREES = 15
NAMES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}


def write_mesh(path: Path, mesh: Mesh, colour: np.ndarray) -> None:
    """Write a mesh; colour: (n, 3) 8-bit."""
    numbers = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    kind = np.dtype([*numbers, *((name, "u1") for name in ("red", "green", "blue"))])
    rows = np.empty(len(mesh.vertices), kind)
    for names, values in ((("x", "y", "z"), mesh.vertices), (("nx", "ny", "nz"), mesh.normals),
                          (("red", "green", "blue"), colour)):  # fmt: skip
        for k, name in enumerate(names):
            rows[name] = values[:, k]
    faces = np.empty(len(mesh.faces), [("number", "u1"), ("vertices", "<i4", 3)])
    faces["number"], faces["vertices"] = 3, mesh.faces
    head = _element("vertex", rows) + f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    _write(path, head, rows.tobytes() + faces.tobytes())


def write_splats(path: Path, splats: Splats, colours: np.ndarray) -> None:
    """Write splats; colours: (n, 3, 1 + K) in 0 … 1, as `Splats.colours` gives them."""
    number = colours.shape[2] - 1
    rest = [f"f_rest_{k}" for k in range(3 * THREE_DEGREES if number else 0)]
    names = ("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity", "scale_0", "scale_1",
             "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")  # fmt: skip
    rows = np.zeros(len(splats.centre), [(name, "<f4") for name in names])
    for k, name in enumerate(("x", "y", "z")):
        rows[name] = splats.centre[:, k]
    band_0 = 0.28209479177387814  # the constant spherical harmonic, 1 / (2 √π): splats hold colour − 0.5 in units of it
    for c in range(3):
        rows[f"f_dc_{c}"] = (colours[:, c, 0] - 0.5) / band_0
        rows[f"scale_{c}"] = np.log(splats.deviation[:, c])
        for k in range(number):
            rows[f"f_rest_{c * THREE_DEGREES + k}"] = SIGNS[k] * colours[:, c, 1 + ORDER[k]] / band_0
    rows["opacity"] = np.log(splats.opacity / (1 - splats.opacity))
    rows["rot_0"] = 1.0
    _write(path, _element("vertex", rows), rows.tobytes())


def _element(name: str, rows: np.ndarray) -> str:
    assert rows.dtype.names is not None
    lines = [f"property {NAMES[rows.dtype[field].str]} {field}\n" for field in rows.dtype.names]
    return f"element {name} {len(rows)}\n" + "".join(lines)


def _write(path: Path, head: str, body: bytes) -> None:
    path.write_bytes(f"ply\nformat binary_little_endian 1.0\n{head}end_header\n".encode() + body)
