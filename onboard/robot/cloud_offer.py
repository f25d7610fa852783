"""The carrier's side of a co-localisation: keep what it sees around itself and send it."""

from __future__ import annotations

from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.local_cloud import LocalCloud
from onboard.localization.surroundings import Surroundings, surroundings_to_bytes
from onboard.planning.relocation import Moved
from onboard.sharing import LinkCore
from onboard.sharing.messages import CHUNK_BYTES, Missing
from onboard.sharing.transfer import DataSender

RATE_SHARE = 0.5
"""Of the radio's rate: the other half is for keyframes."""
SAVED_S = 0.25
"""Chunks that were not sent may follow at once, up to those of this time."""
SILENCE_S = 4.0
"""A robot that has everything and says nothing for so long has been restarted: it is offered again."""


class CloudOffer:
    """Feed it with every scan; between `begin` and `end` it sends, in contact only, within the rate."""

    def __init__(self, link: LinkCore, rate_bytes_s: float) -> None:
        self._link = link
        self._rate_bytes_s = RATE_SHARE * rate_bytes_s
        self._cloud = LocalCloud()
        self._sender: DataSender | None = None
        self._data = b""
        self._to = 0
        self._saved_bytes = 0.0
        self._stepped_s = 0.0
        self._heard_s = 0.0

    def saw(self, scan: Scan, sensor: Pose) -> None:
        """Take in a scan of the LiDAR at `sensor` in the map."""
        self._cloud.add(scan.points(), sensor)

    def follow(self, moved: Moved) -> None:
        """The map has been drawn anew; what is being offered stays as it is."""
        self._cloud.move(moved)

    def begin(self, now_s: float, name: int, to: int, sensor: Pose) -> None:
        """Offer the cloud as it is now to robot `to`, whose LiDAR should be at `sensor` in the map."""
        self._data = surroundings_to_bytes(Surroundings(sensor, self._cloud.points()))
        self._sender = DataSender(name, self._data)
        self._to = to
        self._saved_bytes = 0.0
        self._stepped_s = self._heard_s = now_s

    def end(self) -> None:
        """Nothing more is sent."""
        self._sender = None

    def told(self, now_s: float, source: int) -> None:
        """The robot has said what came of it."""
        if source == self._to:
            self._heard_s = now_s

    def handle(self, now_s: float, source: int, message: Missing) -> None:
        """What the robot lacks."""
        if self._sender is None or source != self._to:
            return
        before = self._sender.done
        self._sender.handle(now_s, message)
        if self._sender.done and not before:
            self._heard_s = now_s

    def step(self, now_s: float) -> None:
        """Post what is due."""
        passed_s, self._stepped_s = now_s - self._stepped_s, now_s
        if self._sender is None or not self._link.in_contact(self._to, now_s):
            return
        if self._sender.done and now_s - self._heard_s > SILENCE_S:
            self._sender = DataSender(self._sender.offer.name, self._data)
        saved = self._saved_bytes + self._rate_bytes_s * passed_s
        self._saved_bytes = min(saved, max(self._rate_bytes_s * SAVED_S, CHUNK_BYTES))
        for message in self._sender.step(now_s, int(self._saved_bytes / CHUNK_BYTES)):
            self._link.post(message, self._to)
            self._saved_bytes -= CHUNK_BYTES if message is not self._sender.offer else 0
