"""Readers of point cloud files: PCD, PLY, legacy VTK, KITTI bin and NumPy.

Small readers of our own: what the station installs reads only some of these (ouster-sdk refuses headers
with a leading comment, small_gicp reads one fixed PLY layout).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.core.errors import InputError

Points = NDArray[np.float32]

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_VTK_TYPES = {"float": ">f4", "double": ">f8"}


def _xyz(table: NDArray[np.void]) -> Points:
    return np.stack([table["x"], table["y"], table["z"]], axis=-1).astype(np.float32).reshape(-1, 3)


def _columns(text: bytes, names: list[str], rows: int) -> Points:
    """x, y, z of `rows` lines of numbers whose columns are called `names`."""
    values = np.array(text.split()[: rows * len(names)], dtype=np.float64).reshape(rows, len(names))
    return values[:, [names.index(axis) for axis in "xyz"]].astype(np.float32)


def read_ply(data: bytes) -> Points:
    """Vertices of a PLY file (ascii or binary); the vertex element must come first."""
    header, _, body = data.partition(b"end_header")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    encoding = next(words[1] for words in lines if words[:1] == ["format"])
    elements = [i for i, words in enumerate(lines) if words[:1] == ["element"]]
    if not elements or lines[elements[0]][1] != "vertex":
        raise ValueError("the first element is not 'vertex'")
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = [words for words in lines[elements[0] + 1 : end] if words[:1] == ["property"]]
    count = int(lines[elements[0]][2])
    body = body[body.index(b"\n") + 1 :]
    if encoding == "ascii":
        return _columns(body, [words[-1] for words in properties], count)
    order = "<" if encoding == "binary_little_endian" else ">"
    dtype = np.dtype([(words[-1], order + _PLY_TYPES[words[1]]) for words in properties])
    return _xyz(np.frombuffer(body, dtype=dtype, count=count))


def read_pcd(data: bytes) -> Points:
    """Points of a PCD v0.7 file: ascii, binary or binary_compressed."""
    start = data.index(b"\nDATA ") + 1
    end = data.index(b"\n", start)
    lines = data[:end].decode("ascii").splitlines()
    fields = {words[0]: words[1:] for words in (line.split() for line in lines) if words}
    names, count = fields["FIELDS"], int(fields["POINTS"][0])
    repeats = [int(n) for n in fields.get("COUNT", ["1"] * len(names))]
    kinds = [t.lower() + s for t, s in zip(fields["TYPE"], fields["SIZE"], strict=True)]
    columns = [(f"_{i}" if n == "_" else n, "<" + k, (r,)) for i, (n, k, r) in enumerate(
        zip(names, kinds, repeats, strict=True))]  # fmt: skip
    body = data[end + 1 :]
    match fields["DATA"][0]:
        case "ascii":
            spread = [
                n if r == 1 else f"{n}{j}" for n, r in zip(names, repeats, strict=True) for j in range(r)
            ]
            return _columns(body, spread, count)
        case "binary":
            return _xyz(np.frombuffer(body, dtype=np.dtype(columns), count=count))
        case "binary_compressed":
            return _xyz_by_field(_decompressed(body), columns, count)
        case other:
            raise ValueError(f"unknown DATA '{other}'")


def _decompressed(body: bytes) -> bytes:
    packed, plain = np.frombuffer(body[:8], dtype="<u4")
    return lzf_decompress(body[8 : 8 + int(packed)], int(plain))


def _xyz_by_field(plain: bytes, columns: list[tuple[str, str, tuple[int]]], count: int) -> Points:
    """binary_compressed stores one field after the other instead of point by point."""
    found, offset = {}, 0
    for name, kind, (repeat,) in columns:
        found[name] = np.frombuffer(plain, dtype=kind, count=count * repeat, offset=offset)
        offset += found[name].nbytes
    return np.stack([found[axis] for axis in "xyz"], axis=-1).astype(np.float32)


def lzf_decompress(packed: bytes, size: int) -> bytes:
    """Undo LZF (liblzf: a control byte below 32 starts a literal run, others a back reference).

    Raises ValueError when the bytes do not unpack to `size`.
    """
    out = bytearray()
    i = 0
    while i < len(packed):
        control = packed[i]
        i += 1
        if control < 32:
            out += packed[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[i]
            i += 1
        distance = ((control & 31) << 8) + packed[i] + 1
        i += 1
        if distance > len(out):
            raise ValueError("LZF reference before the start")
        for _ in range(length + 2):
            out.append(out[-distance])
    if len(out) != size:
        raise ValueError(f"LZF gave {len(out)} bytes, not {size}")
    return bytes(out)


def read_vtk(data: bytes) -> Points:
    """POINTS of a legacy VTK PolyData file, ascii or binary (big endian)."""
    encoding = data.split(b"\n", 3)[2].strip()
    start = data.index(b"\nPOINTS ") + 1
    end = data.index(b"\n", start)
    _, count, kind = data[start:end].decode("ascii").split()
    body = data[end + 1 :]
    if encoding == b"ASCII":
        return _columns(body, ["x", "y", "z"], int(count))
    values = np.frombuffer(body, dtype=_VTK_TYPES[kind], count=3 * int(count))
    return values.reshape(-1, 3).astype(np.float32)


def read_kitti(data: bytes) -> Points:
    """KITTI Velodyne scan: float32 x, y, z, intensity."""
    return np.frombuffer(data, dtype="<f4").reshape(-1, 4)[:, :3].copy()


READERS: dict[str, Callable[[bytes], Points]] = {
    ".bin": read_kitti,
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".vtk": read_vtk,
}
NUMPY_SUFFIXES = (".npy", ".npz")
SUFFIXES = (*READERS, *NUMPY_SUFFIXES)


def read_numpy(path: Path) -> Points:
    """(N, 3 or more) array of an .npy file, or the one such array (or 'points') of an .npz file."""
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        array = loaded
    else:
        with loaded:
            array = loaded["points" if "points" in loaded.files else loaded.files[0]]
    if array.ndim != 2 or array.shape[1] < 3:
        raise ValueError(f"shape {array.shape}, expected (N, 3)")
    return array[:, :3].astype(np.float32)


def read_points(path: Path) -> Points:
    """(N, 3) finite points of any supported file. Raises InputError that names the file."""
    try:
        numpy_file = path.suffix in NUMPY_SUFFIXES
        points = read_numpy(path) if numpy_file else READERS[path.suffix](path.read_bytes())
    except (ValueError, KeyError, IndexError, StopIteration, OverflowError, EOFError, OSError) as error:
        raise InputError(f"{path}: not a readable {path.suffix[1:]} point cloud ({error})") from error
    return points[np.isfinite(points).all(axis=1)]
