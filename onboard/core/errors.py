"""One exception tree. Libraries raise these; only the CLI and the daemon loop catch them."""


class MarsupialError(Exception):
    """Base of every error that this product raises on purpose."""


class InputError(MarsupialError):
    """Something a user gave us cannot be used: the message names it and says what to do."""


class ConfigError(InputError):
    """The configuration is wrong: the message names file, key, value and bound."""


class WireError(MarsupialError):
    """Bytes that came over a link do not decode; they are counted and dropped."""


class CodecError(WireError):
    """A keyframe's bytes are not what an encoder wrote."""
