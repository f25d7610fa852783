"""The exported networks and what they say about themselves."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from onboard.core.errors import InputError

MANIFEST = "manifest.json"
ENCODER, DECODER, TABLES = "encoder.onnx", "decoder.onnx", "latents.npz"
Floats = NDArray[np.float32]


class Manifest(BaseModel):
    """What `manifest.json` beside an exported network holds."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    version: Literal[1] = 1
    sensor: str
    latents: Annotated[int, Field(ge=1, le=4096)]
    voxel_m: Annotated[float, Field(gt=0)]
    image_max_range_m: Annotated[float, Field(gt=0)]
    free_beyond_m: Annotated[float, Field(gt=0)]
    """Decoded ranges from here on mean a ray without return."""
    step_sigma: Annotated[float, Field(gt=0)]
    """Quantiser step in standard deviations of the posterior."""
    precision: Literal["float32", "int8"]
    sha256: dict[str, str]
    """Of every file beside the manifest."""
    training: dict[str, str | bool | int | float]
    """How the network came about: steps, scans, losses."""

    @property
    def tag(self) -> bytes:
        """Two bytes that tell models apart on the wire."""
        digests = "".join(self.sha256[name] for name in (DECODER, TABLES))
        return hashlib.sha256(digests.encode()).digest()[:2]


def load_manifest(directory: Path) -> Manifest:
    """The manifest of an exported model. Raises InputError where it is missing or wrong."""
    path = directory / MANIFEST
    if not path.is_file():
        raise InputError(f"{path}: no learned model here; export one or name the directory that holds one")
    try:
        manifest = Manifest.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise InputError(f"{path}: {error}") from error
    if missing := {DECODER, TABLES} - set(manifest.sha256):
        raise InputError(f"{path}: sha256: no entry for {', '.join(sorted(missing))}")
    return manifest


def checked_bytes(directory: Path, name: str, manifest: Manifest) -> bytes:
    """A file's bytes. Raises InputError where it is missing or not the one that the manifest describes."""
    path = directory / name
    if not path.is_file():
        raise InputError(f"{path}: missing; export the model again")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != manifest.sha256.get(name):
        raise InputError(f"{path}: not the file that {MANIFEST} describes; export the model again")
    return data


class Network:
    """One ONNX graph with one input and one output, run on one thread of the CPU.

    Raises InputError where onnxruntime is not installed or refuses the graph.
    """

    def __init__(self, graph: bytes, origin: Path) -> None:
        try:
            import onnxruntime  # noqa: PLC0415  (an optional extra, and heavy)
        except ImportError as error:
            raise InputError(
                "the learned codec needs onnxruntime; install the extra: pip install 'marsupial[learned]'"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.add_session_config_entry("session.inter_op.allow_spinning", "0")
        try:
            self._session: Any = onnxruntime.InferenceSession(graph, options, ["CPUExecutionProvider"])
        except Exception as error:  # its exception classes are private
            raise InputError(f"{origin}: onnxruntime cannot use it: {error}") from error
        self._input = self._session.get_inputs()[0].name

    def __call__(self, value: Floats) -> Floats:
        """The output for one input, both with a leading batch axis."""
        return np.asarray(self._session.run(None, {self._input: value})[0], dtype=np.float32)
