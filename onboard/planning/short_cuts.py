"""Ways that nobody has gone yet: the local graph knows free space that the global graph goes around."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from onboard.planning.global_graph import MERGE_M, GlobalGraph, Visible
from onboard.planning.local_graph import LocalGraph

AT_ONCE = 3
SAVED_M = 4.0
DETOUR = 1.3
"""A way of the local graph has to be that much shorter than the one that is known."""


def add_short_cuts(graph: GlobalGraph, local: LocalGraph, visible: Visible) -> int:
    """Join the robot's node with known nodes that the local graph reaches on a much shorter way.

    At most AT_ONCE of them, those that save most first; a node that the global graph does not reach at all
    saves more than any other. Returns how many were added.
    """
    tree = cKDTree(local.points)
    for added in range(AT_ONCE):
        nodes = np.flatnonzero(np.isfinite(graph.points[:, 0]))  # a removed node is nowhere
        offsets_m, vertices = tree.query(graph.points[nodes], distance_upper_bound=MERGE_M)
        near = np.flatnonzero(np.isfinite(offsets_m))
        if len(near) == 0:
            return added
        direct_m = local.distances_m[vertices[near]] + offsets_m[near]
        saved_m = graph.distances(graph.here)[nodes[near]] - DETOUR * direct_m
        best = int(np.argmax(saved_m))
        if saved_m[best] < SAVED_M:
            return added
        graph.join(local.path(int(vertices[near[best]])), int(nodes[near[best]]), visible)
    return AT_ONCE
