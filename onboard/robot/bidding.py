"""The robot's part in the auction of what to explore: bids go out, those of others come in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from onboard.core.config import RobotSettings
from onboard.planning.auction import Auction, Bid, Bundle, Wish
from onboard.planning.cycle import Candidate
from onboard.planning.local_graph import FloatArray
from onboard.sharing import LinkCore
from onboard.sharing.messages import MAX_BUNDLES, BidMessage, Bids, BundleMessage

BID_PERIOD_S = 3.0


class Bidding:
    """Keeps the auction of one robot in step with its planning cycles and its link."""

    def __init__(self, settings: RobotSettings, link: LinkCore) -> None:
        self._auction = Auction(settings.id, settings.speed_m_s)
        self._start_up_s = settings.planner.start_up_s
        self._link = link
        self._bid_s = -np.inf

    def planned(self, now_s: float, candidates: Iterable[Candidate], peers: Iterable[int]) -> None:
        """Bid for what a planning cycle found worth looking at, and tell those of `peers` in contact."""
        if now_s - self._bid_s < BID_PERIOD_S:
            return
        self._bid_s = now_s
        plans = [candidate.plan for candidate in candidates if len(candidate.plan.path)]
        wishes = [Wish(plan.goal, plan.gain_m3, plan.time_s) for plan in plans]
        self._auction.bid(now_s, wishes, self._start_up_s)
        bundles = sorted(self._auction.bundles(now_s), key=lambda bundle: -bundle.stamp_s)[:MAX_BUNDLES]
        message = Bids(tuple(_packed(bundle, now_s) for bundle in bundles))
        for peer in peers:
            if self._link.in_contact(peer, now_s):
                self._link.post(message, peer)

    def came(self, now_s: float, message: Bids) -> None:
        """Take in what a peer knows of others' bids."""
        for bundle in message.bundles:
            bids = tuple(Bid(np.array(bid.position_m), bid.score) for bid in bundle.bids)
            self._auction.receive(Bundle(bundle.robot, now_s - bundle.age_s, bids))

    def taken(self, now_s: float) -> list[FloatArray]:
        """Places (3,) that others have won."""
        return self._auction.taken(now_s)


def _packed(bundle: Bundle, now_s: float) -> BundleMessage:
    bids = tuple(BidMessage(_plain(bid.position), bid.score) for bid in bundle.bids)
    return BundleMessage(bundle.robot, max(0.0, now_s - bundle.stamp_s), bids)


def _plain(point: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in point)
    return (x, y, z)
