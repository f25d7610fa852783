"""Whole teams whose aerial robot must find itself in its carrier's map before the bracket opens."""

from __future__ import annotations

import numpy as np

from onboard.core.config import Config
from onboard.core.geometry import Pose, rotation_angle
from onboard.core.lidar import VLP_16, Scan
from onboard.mission import FLYING, Phase
from onboard.robot.core import RobotCore
from onboard.robot.flyer import Flyer
from onboard.robot.map_frame import Estimated
from onboard.sharing.messages import Release, Target
from simulation.localisation import Poses
from simulation.mission import Mission
from simulation.scene import Scene
from simulation.worlds import World
from tests.simulation.conftest import Box, boxes_mesh
from tests.simulation.small_mission import EAGER, Event, room, team

TUNNEL: list[Box] = [
    (-80.0, -1.5, -0.2, 80.0, 1.5, 0.0),
    (-80.0, -1.5, 3.0, 80.0, 1.5, 3.2),
    (-80.0, -1.7, -0.2, 80.0, -1.5, 3.2),
    (-80.0, 1.5, -0.2, 80.0, 1.7, 3.2),
]


HERE = Pose.from_rpy(np.array([0.0, 0.0, 0.95]))


def colocalising(duration_s: float = 40.0, **changes: float) -> Config:
    deployment = {**EAGER, "colocalise": True}
    return team(mission={"duration_s": duration_s}, deployment=deployment, **changes)


def tunnel() -> World:
    """The same everywhere, with ends beyond what a LiDAR of the team sees."""
    vertices, triangles = boxes_mesh(TUNNEL)
    return World("tunnel", None, vertices, triangles, np.array([0.0, 0.0, 0.0]), 0.0)


def begun(config: Config, world: World, poses: Poses = "estimated") -> tuple[Mission, list[Event]]:
    events: list[Event] = []

    def log(time_s: float, kind: str, **fields: object) -> None:
        events.append((time_s, kind, fields))

    return Mission(config, world, Scene(world.vertices, world.triangles), 1, log, poses=poses), events


def until(mission: Mission, events: list[Event], kind: str) -> Event:
    """Play on until something of this kind has happened."""
    while not mission.done():
        mission.tick()
        found = [event for event in events if event[1] == kind]
        if found:
            return found[0]
    raise AssertionError(f"no {kind} in {mission.now_s} s: {events[-5:]}")


def play(mission: Mission, seconds: float) -> None:
    end_s = mission.now_s + seconds
    while mission.now_s < end_s:
        mission.tick()


def test_a_robot_with_an_odometry_of_its_own_flies_in_its_carriers_map():
    mission, events = begun(colocalising(), room())
    released = until(mission, events, "release")
    (located,) = [fields for _, kind, fields in events if kind == "located"]
    assert located["accepted"]
    flyer = mission.agents[1]
    assert isinstance(flyer.core.role, Flyer)
    found = flyer.core.role.map_from_odometry
    assert found is not None
    believed = found.compose(flyer.localisation.told().pose)
    assert np.linalg.norm(believed.position - flyer.pose.position) < 0.05
    assert rotation_angle(believed.quaternion, flyer.pose.quaternion) < np.deg2rad(0.5)
    play(mission, 8.0)
    assert not flyer.carried
    path = np.array(flyer.path)[:, 1:] + np.array(flyer.settings.lidar.mount_m)
    for place in flyer.core.team.keyframe_positions:
        assert np.linalg.norm(path - place, axis=1).min() < 0.05
    assert len(flyer.core.team.keyframe_positions) > 1
    assert released[0] < 15.0


def test_where_poses_are_given_the_bracket_opens_later_by_what_it_takes_and_all_else_is_the_same():
    without, plain = begun(team(mission={"duration_s": 40.0}, deployment=EAGER), room(), "true")
    with_it, careful = begun(colocalising(), room(), "true")
    early = until(without, plain, "release")
    late = until(with_it, careful, "release")
    assert 1.0 < late[0] - early[0] < 6.0
    decisions = [[event for event in log if event[1] == "deploy"] for log in (plain, careful)]
    assert decisions[0] == decisions[1]


def test_in_a_tunnel_that_is_the_same_everywhere_the_bracket_stays_shut():
    mission, events = begun(colocalising(), tunnel())
    _, _, aborted = until(mission, events, "abort")
    assert "too few directions" in str(aborted["reason"])
    play(mission, 3.0)
    assert not [event for event in events if event[1] == "release"]
    assert mission.agents[1].carried
    assert not mission.agents[1].core.maps()


def test_a_robot_restarted_just_before_its_release_finds_itself_anew_before_the_bracket_opens():
    mission, events = begun(colocalising(), room())
    until(mission, events, "located")
    flyer = mission.agents[1]
    settings, log = flyer.settings, flyer.core.team.log
    frame = Estimated(settings.id, Pose.from_rpy(np.array(settings.lidar.mount_m)), None)
    flyer.core = RobotCore(mission.config, settings, 1, flyer.pose, log, lambda: 0.0, frame=frame)
    until(mission, events, "release")
    play(mission, 6.0)
    assert [kind for _, kind, _ in events if kind in ("located", "release")] == [
        "located",
        "located",
        "release",
    ]
    assert flyer.core.phase in FLYING


def test_nobody_but_its_carrier_sends_a_robot_off():
    mission, _ = begun(team(mission={"duration_s": 10.0}), room(), "true")
    role, carrier = mission.agents[1].core.role, mission.agents[0].settings.id
    for source, released in ((carrier + 2, False), (carrier, True)):
        role.handle(0.5, source, Target((1.0, 0.0, 1.0)), HERE)
        role.handle(0.5, source, Release((0.0, 0.0, 0.7)), HERE)
        assert role.facts(0.5, Phase.CARRIED, HERE).released is released


def test_a_carrier_blanks_the_robot_on_its_back_although_that_one_does_not_know_where_it_is():
    mission, _ = begun(colocalising(), room())
    play(mission, 2.5)
    carrier, flyer = mission.agents
    core = carrier.core
    sensor = core.sensing.sensor_pose(carrier.pose)
    towards = sensor.inverse().compose(flyer.pose).position
    nearest = np.argmax(VLP_16.directions @ towards.astype(np.float32))
    ranges = np.full((VLP_16.rows, VLP_16.columns), 4.0, dtype=np.float32)
    ranges.reshape(-1)[nearest] = np.linalg.norm(towards)
    kept = core.team.without_peers(Scan(0.0, ranges, VLP_16), carrier.pose, mission.now_s).ranges > 0
    assert not kept.reshape(-1)[nearest]
    assert kept.sum() == kept.size - 1
