"""Rate and distortion of the keyframe codecs on simulated scans of many worlds."""
