"""`simulate`: one mission in one process, many times faster than real time, into a run directory."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ground_station.export import EventLog, write_json, write_ply
from ground_station.octomap import write_octomap
from ground_station.palette import observer_colours
from ground_station.record import Marker, RunRecord
from ground_station.report import write_report
from onboard.core.config import Config
from onboard.core.errors import ConfigError
from onboard.core.geometry import Pose
from onboard.mapping.voxel_map import OWN
from onboard.planning.explorer import Explorer
from onboard.robot.core import PlannerFactory
from onboard.robot.roles import vector
from simulation.agent import launch_pose
from simulation.coverage import Coverage
from simulation.localisation import Poses
from simulation.mission import Mission
from simulation.scene import Scene
from simulation.scoring import is_complete, merged_map, metrics, volume_m3
from simulation.truth import Truth
from simulation.worlds import World

REPORT_PERIOD_S = 5.0


@dataclass(frozen=True)
class Progress:
    """State of a running simulation for a progress display."""

    time_s: float
    duration_s: float
    phase: str
    explored_m3: dict[str, float]
    union_m3: float
    message: str = ""


def simulate(
    config: Config,
    world: World,
    seed: int,
    out: Path,
    team: str = "both",
    progress: Callable[[Progress], None] | None = None,
    planner: PlannerFactory = Explorer,
    report: bool = True,
    octomap: bool = False,
    poses: Poses = "estimated",
) -> dict[str, Any]:
    """Run a mission and write metrics.json, map.ply, events.jsonl and report.html into the directory `out`;
    with `octomap` also map.bt.

    `team` is "both", "ground" or "aerial". Returns the metrics. After ctrl-C the directory holds what
    there is and KeyboardInterrupt goes on. `planner` makes the planner of every robot;
    without `report` there is no report.html. With `poses` "true" the robots are told where they are. Raises
    InputError for a start without ground or room to fly.
    """
    started = time.perf_counter()
    config = within_world(select_team(config, team), world)
    scene = Scene(world.vertices, world.triangles)
    truth = reachable(config, world)
    with EventLog(out / "events.jsonl") as events:
        run = Run(config, world, scene, seed, events, planner, Coverage(truth), poses)
        try:
            run.loop(progress)
        finally:
            result = metrics(run.mission, truth, time.perf_counter() - started)
            events.write(run.mission.now_s, "end", complete=result["complete"])
            run.write(out, result, progress, report)
            if octomap:
                run.write_octomap(out)
    return result


def select_team(config: Config, team: str) -> Config:
    """The configuration with only the robots that take part."""
    robots = tuple(robot for robot in config.robots if team in ("both", robot.kind))
    if not any(robot.kind == "ground" for robot in robots) and team != "aerial":
        raise ConfigError("robots: a mission needs a ground robot, which carries the others")
    if not robots:
        raise ConfigError("robots: there is no aerial robot that could fly alone")
    return config.model_copy(update={"robots": robots})


def within_world(config: Config, world: World) -> Config:
    """The configuration with the world's bounds as the area to explore, unless it names one."""
    if config.mission.area_m is not None:
        return config
    area = (vector(world.lower), vector(world.upper))
    return config.model_copy(update={"mission": config.mission.model_copy(update={"area_m": area})})


def reachable(config: Config, world: World) -> Truth:
    """The free volume that a flying robot of the paper's size reaches from the start."""
    aerial = next((robot for robot in config.robots if robot.kind == "aerial"), None)
    half = (0.19, 0.19, 0.12) if aerial is None else tuple(size / 2 for size in aerial.size_m)
    from_pose = launch_pose(Pose.from_rpy(world.start), config)
    return Truth(
        world.vertices, world.triangles, config.map.voxel_m, from_pose.position, (half[0], half[1], half[2])
    )


class Run:
    """A mission with the record that is kept of it."""

    def __init__(
        self,
        config: Config,
        world: World,
        scene: Scene,
        seed: int,
        events: EventLog,
        planner: PlannerFactory,
        coverage: Coverage,
        poses: Poses,
    ) -> None:
        self.mission = Mission(config, world, scene, seed, self._event, planner, poses)
        self._coverage = coverage
        self._events = events
        self._timeline: dict[str, list[float]] = {}
        self._markers = [Marker("start", "start", vector(world.start), 0.0)]

    def _event(self, time_s: float, kind: str, **fields: Any) -> None:
        self._events.write(time_s, kind, **fields)
        if kind == "deploy":
            self.mission.deployment = self.mission.deployment or {
                "time_s": time_s,
                "target": fields["target"],
            }
            self._markers.append(Marker("deploy", "deploy", fields["position"], time_s))
            self._markers.append(Marker("target", "target", fields["target"], time_s))
        if kind == "regroup" and fields["robot"] == self.mission.lead.name:
            self._markers.append(Marker("regroup", "regroup", fields["position"], time_s))

    def loop(self, progress: Callable[[Progress], None] | None) -> None:
        """Tick until everybody is done or the time is over."""
        next_report_s = 0.0
        while not self.mission.done():
            if self.mission.now_s >= next_report_s:
                next_report_s += REPORT_PERIOD_S
                self._report(progress)
            self.mission.tick()
        self._report(progress)

    def _report(self, progress: Callable[[Progress], None] | None) -> None:
        mission = self.mission
        explored = {agent.name: volume_m3(mission, [agent]) for agent in mission.agents}
        union = volume_m3(mission, mission.agents)
        self._coverage.add([agent.core.explorer.map for agent in mission.agents])
        row = {"time_s": mission.now_s, "explored_m3/union": union, "coverage": self._coverage.share}
        row |= {f"explored_m3/{name}": volume for name, volume in explored.items()}
        for kind in mission.agents[0].core.link.bytes_sent:
            row[f"bytes/{kind}"] = float(sum(agent.core.link.bytes_sent[kind] for agent in mission.agents))
        for key, value in row.items():
            self._timeline.setdefault(key, []).append(value)
        if progress is not None:
            duration_s = mission.config.mission.duration_s
            progress(Progress(mission.now_s, duration_s, mission.phase(), explored, union))

    def write(
        self, out: Path, result: dict[str, Any], progress: Callable[[Progress], None] | None, report: bool
    ) -> None:
        """Write the run directory."""
        self._report(progress)
        record = self.record(result)
        write_json(out / "metrics.json", result)
        write_json(out / "config.json", record.parameters)
        write_json(out / "timeline.json", record.timeline)
        write_json(out / "paths.json", {name: path.round(3) for name, path in record.paths.items()})
        write_ply(out / "map.ply", record.occupied, observer_colours(record.seen_by, len(record.robots)))
        if report:
            write_report(out, record)

    def write_octomap(self, out: Path) -> None:
        """Write the merged map as a tree for OctoMap."""
        merged = merged_map(self.mission)
        write_octomap(out / "map.bt", merged.occupied_indices(), merged.free_indices(), merged.voxel_m)

    def record(self, result: dict[str, Any]) -> RunRecord:
        """The run as the report wants it."""
        mission = self.mission
        merged = merged_map(mission)
        voxels = merged.occupied_indices()
        seen = np.zeros(len(voxels), np.uint8)
        for bit, agent in enumerate(mission.agents):
            own = (agent.core.explorer.map.seen_by(voxels) >> OWN) & 1
            seen |= (own << bit).astype(np.uint8)
        return RunRecord(
            title=f"{mission.world.name}, seed {mission.seed}",
            metrics=result,
            parameters=mission.config.model_dump(mode="json"),
            timeline=self._timeline,
            paths={agent.name: np.array(agent.path).reshape(-1, 4) for agent in mission.agents},
            occupied=((voxels + 0.5) * merged.voxel_m).astype(np.float32),
            seen_by=seen,
            robots=[agent.name for agent in mission.agents],
            markers=self._markers,
            complete=is_complete(mission),
        )
