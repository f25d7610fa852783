"""Small plane graphs from which tunnels are drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay

from simulation.worlds.solids import Floats

Edge = tuple[int, int]


def scattered(rng: np.random.Generator, given: Floats, count: int, lower: Floats, upper: Floats) -> Floats:
    """`given` (K, 2) and best-candidate points up to `count`, well apart from each other."""
    points = given
    while len(points) < count:
        candidates = rng.uniform(lower, upper, (40, 2))
        if len(points):
            gap = np.linalg.norm(candidates[:, None] - points[None], axis=2).min(axis=1)
            candidates = candidates[[int(np.argmax(gap))]]
        points = np.concatenate([points, candidates[:1]])
    return points


def network(points: Floats, loops: int, longest_m: float) -> list[Edge]:
    """Spanning tree of (N, 2) points plus the `loops` shortest other Delaunay edges; none cross."""
    sides = np.concatenate([Delaunay(points).simplices[:, [a, b]] for a, b in ((0, 1), (1, 2), (0, 2))])
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    weights = coo_matrix((lengths, edges.T), shape=(len(points), len(points)))
    tree = minimum_spanning_tree(weights).tocoo()
    chosen = {(int(min(a, b)), int(max(a, b))) for a, b in zip(tree.row, tree.col, strict=True)}
    for k in np.argsort(lengths):
        edge = (int(edges[k, 0]), int(edges[k, 1]))
        if loops > 0 and edge not in chosen and lengths[k] <= longest_m:
            chosen.add(edge)
            loops -= 1
    return sorted(chosen)


def connected(nodes: Sequence[int], edges: Sequence[Edge]) -> bool:
    """Whether the edges join all the nodes."""
    place = {node: k for k, node in enumerate(nodes)}
    pairs = np.array([(place[a], place[b]) for a, b in edges if a in place and b in place]).reshape(-1, 2)
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(nodes), len(nodes)))
    return int(connected_components(links, directed=False)[0]) == 1


def thinned(
    rng: np.random.Generator, nodes: Sequence[int], edges: Sequence[Edge], share: float
) -> list[Edge]:
    """The edges without a random `share` of them, the nodes still joined."""
    kept = list(edges)
    remove = round(share * len(edges))
    for k in rng.permutation(len(edges)):
        without = [edge for edge in kept if edge != edges[k]]
        if remove > 0 and connected(nodes, without):
            kept = without
            remove -= 1
    return kept
