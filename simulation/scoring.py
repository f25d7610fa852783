"""The numbers of a mission; the only place besides the sensors that may look at the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.mapping.compare import compare_maps
from onboard.mapping.union import union_count
from onboard.mapping.voxel_map import OWN, VoxelMap
from onboard.mission import ABOARD, AT_REGROUP, Phase
from simulation.agent import Agent
from simulation.mission import Mission
from simulation.truth import Truth

FINISHED = frozenset({Phase.LANDING, Phase.DONE})


def volume_m3(mission: Mission, agents: list[Agent]) -> float:
    """Volume inside the world's bounds that the LiDARs of these robots have seen."""
    maps = [agent.core.explorer.map for agent in agents]
    count = union_count(maps, mission.world.lower, mission.world.upper, OWN)
    return float(count * mission.config.map.voxel_m**3)


def merged_map(mission: Mission) -> VoxelMap:
    """The map after the mission: the carrier's, into which the keyframes of the others were integrated.

    Without a carrier it is that of the first robot.
    """
    return mission.lead.core.explorer.map


def metrics(mission: Mission, truth: Truth, wall_s: float) -> dict[str, Any]:
    """Everything of metrics.json. Wall-clock fields: wall_s, plan_ms_p50, plan_ms_p99, map_ms_p50."""
    flying = [agent for agent in mission.agents if agent.settings.kind == "aerial" and not agent.carried]
    deployment = mission.deployment
    union = volume_m3(mission, mission.agents)
    regroup = mission.lead.core.role.regroup_point()
    score = compare_maps(mission.reference, merged_map(mission), mission.world.lower, mission.world.upper)
    return {
        "world": mission.world.name,
        "seed": mission.seed,
        "duration_s": round(mission.now_s, 1),
        "wall_s": round(wall_s, 1),
        "robots": {agent.name: _robot(mission, agent) for agent in mission.agents},
        "deployed": bool(mission.carriers and flying),
        "deploy_t_s": None if deployment is None else deployment["time_s"],
        "target": None if deployment is None else _rounded(deployment["target"]),
        "regroup": None if regroup is None else _rounded(regroup),
        "union_m3": round(union, 2),
        "reachable_m3": round(truth.reachable_m3, 2),
        "coverage": round(coverage(mission, truth), 4),
        "merged": {
            "occ_f1": round(score.occ_f1, 4),
            "occ_precision": round(score.occ_precision, 4),
            "occ_recall": round(score.occ_recall, 4),
            "free_iou": round(score.free_iou, 4),
            "unsafe26": round(score.unsafe26, 6),
        },
        "complete": is_complete(mission),
    }


def is_complete(mission: Mission) -> bool:
    """Whether every robot is at the regrouping point and all keyframes have been exchanged."""
    return all(agent.core.phase in FINISHED or agent.carried for agent in mission.agents)


def coverage(mission: Mission, truth: Truth) -> float:
    """Share of the volume reachable for the aerial robot that the team has seen."""
    seen = [agent.core.explorer.map.known_indices(OWN) for agent in mission.agents]
    inside = [voxels[truth.contains(voxels)] for voxels in seen]
    keys = np.unique(np.concatenate([_keys(voxels) for voxels in inside]))
    return float(len(keys) * mission.config.map.voxel_m**3 / truth.reachable_m3)


def _keys(voxels: NDArray[np.int32]) -> NDArray[np.int64]:
    x, y, z = (voxels.astype(np.int64) + (1 << 20)).T
    return np.asarray((x << 42) | (y << 21) | z)


def _robot(mission: Mission, agent: Agent) -> dict[str, Any]:
    core, body = agent.core, agent.body
    plans = core.profile.times_ms.get("plan", [])
    maps = core.profile.times_ms.get("map", [])
    home = core.phase in AT_REGROUP - ABOARD
    return {
        "explored_m3": round(volume_m3(mission, [agent]), 2),
        "path_m": round(body.path_m, 2),
        "collisions": body.collisions + (mission.meetings if agent.settings.kind == "aerial" else 0),
        "min_clearance_m": round(body.min_clearance_m, 3) if np.isfinite(body.min_clearance_m) else None,
        "keyframes": len(core.team.keyframe_positions),
        "keyframe_bytes": core.team.keyframe_bytes,
        "bytes_sent": sum(core.link.bytes_sent.values()),
        "bytes_received": sum(core.link.bytes_received.values()),
        "plans": len(plans),
        "plan_ms_p50": _percentile(plans, 50),
        "plan_ms_p99": _percentile(plans, 99),
        "map_ms_p50": _percentile(maps, 50),
        "pose_error_m": round(agent.pose_error_m, 3),
        "worst_pose_error_m": round(agent.worst_pose_error_m, 3),
        "home": bool(home),
        "home_t_s": None if core.arrived_s is None or not home else round(core.arrived_s, 1),
    }


def _percentile(values: list[float], q: float) -> float | None:
    return round(float(np.percentile(values, q)), 2) if values else None


def _rounded(point: Any) -> list[float]:
    return [round(float(value), 2) for value in point]
