"""Learned keyframe codec: a trained network's latents, quantised and entropy coded. Needs onnxruntime."""

from onboard.codec.learned.codec import LearnedCodec, decode_learned, encode_learned

__all__ = ["LearnedCodec", "decode_learned", "encode_learned"]
