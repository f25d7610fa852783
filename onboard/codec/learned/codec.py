"""Range image to payload and back through a learned model."""

from __future__ import annotations

from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.codec.learned.inpaint import fill_unknown
from onboard.codec.learned.latent_coder import (
    LatentCode,
    decode_symbols,
    dequantise,
    encode_symbols,
    load_latent_code,
    quantise,
)
from onboard.codec.learned.network import (
    DECODER,
    ENCODER,
    TABLES,
    Manifest,
    Network,
    checked_bytes,
    load_manifest,
)
from onboard.core.errors import CodecError, InputError
from onboard.core.lidar import LidarModel

Ranges = NDArray[np.float32]
WEIGHTS = Path(__file__).parent / "weights"
"""Where models are looked for: one directory per LiDAR, called like it."""
_TAG_BYTES = 2


class LearnedCodec:
    """One exported model. Its networks are loaded when they are first needed: a robot uses its own encoder
    and the others' decoders.

    Raises InputError where the model is missing, damaged or of another LiDAR.
    """

    def __init__(self, directory: Path, model: LidarModel) -> None:
        self.model = model
        self.manifest: Manifest = load_manifest(directory)
        self._directory = directory
        found = self.manifest.sensor, self.manifest.image_max_range_m
        if found != (model.name, model.image_max_range_m):
            raise InputError(f"{directory}: a model of LiDAR {found}, not of '{model.name}'")

    def encode(self, ranges: Ranges) -> bytes:
        """Payload of an image (H, W) in metres (0 = unknown, inf = no return): tag, then coded latents."""
        return self.manifest.tag + encode_symbols(quantise(self.latents(ranges), self.code), self.code)

    def decode(self, payload: bytes) -> Ranges:
        """(H, W) ranges in metres, inf for free rays; every pixel is known.

        Raises CodecError for bytes that this model's encoder did not write.
        """
        if payload[:_TAG_BYTES] != self.manifest.tag:
            raise CodecError(
                f"written by another learned model (tag {payload[:_TAG_BYTES].hex()}, "
                f"here {self.manifest.tag.hex()}); both robots need the same"
            )
        return self.image(dequantise(decode_symbols(payload[_TAG_BYTES:], self.code), self.code))

    def latents(self, ranges: Ranges) -> Ranges:
        """(N,) latents of an image. Raises InputError where it does not fit the LiDAR."""
        if ranges.shape != (self.model.rows, self.model.columns):
            raise InputError(f"ranges {ranges.shape} are not an image of {self.model.name}")
        far = np.float32(self.model.image_max_range_m)
        filled = fill_unknown(np.ascontiguousarray(ranges, dtype=np.float32), far)
        latents: Ranges = self._encoder(filled[None, None] / far)[0]
        return latents

    def image(self, latents: Ranges) -> Ranges:
        """(H, W) ranges in metres of (N,) latents."""
        far = np.float32(self.model.image_max_range_m)
        ranges = np.asarray(self._decoder(latents[None])[0, 0] * far, dtype=np.float32)
        free = ranges >= self.manifest.free_beyond_m
        return np.where(free, np.float32(np.inf), np.maximum(ranges, np.float32(self.model.min_range_m)))

    @cached_property
    def code(self) -> LatentCode:
        """Quantiser and tables of the latents."""
        checked_bytes(self._directory, TABLES, self.manifest)
        code = load_latent_code(self._directory / TABLES)
        if len(code.offsets) != self.manifest.latents:
            raise InputError(
                f"{self._directory / TABLES}: {len(code.offsets)} latents, not {self.manifest.latents}"
            )
        return code

    @cached_property
    def _encoder(self) -> Network:
        return self._network(ENCODER)

    @cached_property
    def _decoder(self) -> Network:
        return self._network(DECODER)

    def _network(self, name: str) -> Network:
        return Network(checked_bytes(self._directory, name, self.manifest), self._directory / name)


@cache
def _installed(model: LidarModel, directory: Path) -> LearnedCodec:
    return LearnedCodec(directory, model)


def encode_learned(ranges: Ranges, model: LidarModel, directory: Path | None = None) -> bytes:
    """Payload of an image by the model in `directory` (else the installed one); errors as `LearnedCodec`."""
    return _installed(model, directory or WEIGHTS / model.name).encode(ranges)


def decode_learned(payload: bytes, model: LidarModel, directory: Path | None = None) -> Ranges:
    """(H, W) ranges of a payload by the same model; errors as `LearnedCodec`, CodecError for bad bytes."""
    return _installed(model, directory or WEIGHTS / model.name).decode(payload)
