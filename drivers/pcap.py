"""UDP payloads of a capture (pcap or pcapng), fragments of large packets put together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

from drivers.types import Packet
from onboard.core.errors import InputError

FRAGMENTED_MAX = 64
"""Datagrams whose fragments are waited for at once; a lost fragment must not fill the memory."""
ETHERNET, LOOPBACK, OPEN_LOOPBACK, RAW_IP, LINUX_COOKED, LINUX_COOKED_2 = 1, 0, 108, 101, 113, 276
LINK_HEADER_BYTES = {
    ETHERNET: 14, LOOPBACK: 4, OPEN_LOOPBACK: 4, RAW_IP: 0, LINUX_COOKED: 16, LINUX_COOKED_2: 20,
}  # fmt: skip
"""Bytes before the IP header by the capture's link type (tcpdump.org/linktypes.html)."""
VLAN_TYPES = (b"\x81\x00", b"\x88\xa8")
IP_HEADER_BYTES, UDP_HEADER_BYTES = 20, 8
UDP_PROTOCOL = 17
MORE_FRAGMENTS, FRAGMENT_OFFSET = 0x2000, 0x1FFF
FRAGMENT_UNIT_BYTES = 8

_Key = tuple[bytes, bytes]


def pcap_packets(path: Path) -> Iterator[Packet]:
    """UDP payloads in the order of the file, up to a torn end. Raises InputError when it is no capture."""
    import dpkt  # noqa: PLC0415  # an extra of the station

    fragments = Fragments()
    with path.open("rb") as file:
        try:
            reader = dpkt.pcap.UniversalReader(file)
        except (ValueError, dpkt.UnpackError) as error:
            raise InputError(f"{path}: not a readable pcap capture ({error})") from error
        link = reader.datalink()
        if link not in LINK_HEADER_BYTES:
            raise InputError(f"{path}: a capture of link type {link}; capture on an Ethernet interface")
        try:
            for stamp_s, frame in reader:
                found = datagram(bytes(frame), link, fragments)
                if found is not None:
                    yield Packet(float(stamp_s), *found)
        except (dpkt.UnpackError, ValueError):
            return  # a power loss cut the last record


def datagram(frame: bytes, link: int, fragments: Fragments) -> tuple[str, bytes] | None:
    """Sender and payload of a captured frame that is a UDP datagram or the last missing piece of one."""
    start = LINK_HEADER_BYTES[link]
    if link == ETHERNET:
        while frame[start - 2 : start] in VLAN_TYPES:
            start += 4
    packet = frame[start:]
    if len(packet) < IP_HEADER_BYTES or packet[0] >> 4 != 4 or packet[9] != UDP_PROTOCOL:
        return None
    body = packet[(packet[0] & 15) * 4 : int.from_bytes(packet[2:4], "big") or None]
    flags = int.from_bytes(packet[6:8], "big")
    whole: bytes | None = body
    if flags & (MORE_FRAGMENTS | FRAGMENT_OFFSET):
        offset = (flags & FRAGMENT_OFFSET) * FRAGMENT_UNIT_BYTES
        whole = fragments.add((packet[12:20], packet[4:6]), offset, body, bool(flags & MORE_FRAGMENTS))
    if whole is None or len(whole) < UDP_HEADER_BYTES:
        return None
    return ".".join(str(byte) for byte in packet[12:16]), whole[UDP_HEADER_BYTES:]


class Fragments:
    """IP datagrams that come in pieces (RFC 791); the oldest are given up when there are too many."""

    def __init__(self) -> None:
        self._pieces: OrderedDict[_Key, dict[int, bytes]] = OrderedDict()
        self._sizes: dict[_Key, int] = {}

    def add(self, key: _Key, offset: int, body: bytes, more: bool) -> bytes | None:
        """The whole datagram when this was its last missing piece. `key`: addresses and identification."""
        pieces = self._pieces.setdefault(key, {})
        pieces[offset] = body
        if not more:
            self._sizes[key] = offset + len(body)
        if len(self._pieces) > FRAGMENTED_MAX:
            self._sizes.pop(self._pieces.popitem(last=False)[0], None)
        if self._sizes.get(key) != sum(len(piece) for piece in pieces.values()):
            return None
        del self._pieces[key], self._sizes[key]
        return b"".join(piece for _, piece in sorted(pieces.items()))
