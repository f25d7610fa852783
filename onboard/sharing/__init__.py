"""What crosses the radio: frames, keyframe log, synchronisation."""

from onboard.sharing.keyframe_store import KeyframeStore
from onboard.sharing.link import LinkCore

__all__ = ["KeyframeStore", "LinkCore"]
