"""What a peer's body leaves in the map: nothing while it is masked, nothing for long when it was not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ground_station.cli.terminal import default_config_path
from onboard.codec import encode
from onboard.core.config import BracketSettings, Config, LidarSettings, load_config
from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.localization.bracket import carried_pose
from onboard.mapping.voxel_map import OCCUPIED, VoxelMap
from onboard.mission import Phase
from onboard.robot.roles import Team
from onboard.robot.sensing import Sensing
from simulation.lidar import Body, LidarSimulator
from simulation.scene import Scene
from simulation.worlds.solids import Mesh, hull, joined

WALKER_M = (0.93, 0.53, 0.80)
CLEAR_OF_WALLS_M = np.array([-3.0, -1.1, 0.4]), np.array([12.0, 1.1, 2.1])
HANDED_OVER_SCANS = 20
CONFIG: Config = load_config(default_config_path())


def box(lower: tuple[float, float, float], upper: tuple[float, float, float]) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    return hull(np.array(lower) + corners * (np.array(upper) - np.array(lower)))


def corridor() -> Scene:
    """80 m long, 3 m wide, 2.5 m high and open at both ends: rays along it do not come back."""
    sides = [box((-40, -1.9, -0.4), (40, -1.5, 2.9)), box((-40, 1.5, -0.4), (40, 1.9, 2.9))]
    level = [box((-40, -1.9, -0.4), (40, 1.9, 0.0)), box((-40, -1.9, 2.5), (40, 1.9, 2.9))]
    mesh = joined(sides + level)
    return Scene(mesh.vertices.astype(np.float32), mesh.triangles)


SCENE = corridor()


def lidar(model: str, seed: int = 0) -> LidarSimulator:
    settings = LidarSettings.model_validate(
        {"model": model, "mount_m": (0.0, 0.0, 0.0), "noise_std_m": 0.02, "dropout": 0.02}
    )
    return LidarSimulator(SCENE, settings, np.random.default_rng(seed))


def add(voxel_map: VoxelMap, scan: Scan, pose: Pose) -> None:
    rays = scan.rays(25.0)
    voxel_map.integrate(rays, pose.matrix(), min_range_m=scan.model.min_range_m)


def hanging(voxel_map: VoxelMap) -> int:
    """Occupied voxels in the air of the corridor."""
    centres = (voxel_map.occupied_indices() + 0.5) * voxel_map.voxel_m
    lower, upper = CLEAR_OF_WALLS_M
    return int(((centres > lower) & (centres < upper)).all(axis=1).sum())


@pytest.mark.parametrize("model", ["vlp-16", "os0-64"])
@pytest.mark.parametrize("distance_m", [2.5, 5.0, 9.0])
@pytest.mark.parametrize("stride_m", [0.0, 0.07], ids=["stands", "walks"])
def test_ghost_of_a_body_is_gone_ten_scans_after_it_left(model, distance_m, stride_m):
    sensor, simulator, voxel_map = Pose.from_rpy(np.array([0.0, 0.0, 0.7])), lidar(model), VoxelMap()
    for step in range(HANDED_OVER_SCANS):
        across = stride_m * (step - HANDED_OVER_SCANS / 2)
        body: Body = (Pose.from_rpy(np.array([distance_m, across, 0.4]), yaw_rad=1.4), WALKER_M)
        add(voxel_map, simulator.scan(sensor, 0.1 * step, [body])[0], sensor)
    assert hanging(voxel_map) > 3
    for step in range(10):
        add(voxel_map, simulator.scan(sensor, 2.0 + 0.1 * step)[0], sensor)
    assert hanging(voxel_map) == 0
    crossing = [[distance_m, y, 0.75] for y in np.arange(-0.8, 0.81, 0.2)]
    assert OCCUPIED not in voxel_map.box_status(crossing, [0.46, 0.26, 0.35])


def test_rays_without_return_clear():
    sensor, simulator = Pose.from_rpy(np.array([0.0, 0.0, 1.2])), lidar("os0-64")
    scan = simulator.scan(sensor, 0.0)[0]
    assert np.isinf(scan.ranges).any()
    voxel_map, returns_only = VoxelMap(), VoxelMap()
    add(voxel_map, scan, sensor)
    returns_only.integrate(scan.points(), sensor.matrix(), min_range_m=scan.model.min_range_m)
    far = [14.0, -1.3, 0.8], [19.0, 1.3, 1.6]
    assert voxel_map.known_count(*far) > returns_only.known_count(*far)
    occupied = [set(map(tuple, m.occupied_indices().tolist())) for m in (voxel_map, returns_only)]
    assert occupied[0] <= occupied[1]  # rays without return never occupy


def team(name: str, position: np.ndarray, stamp_s: float) -> Team:
    """The team as one robot knows it: its only peer has told this position."""
    settings = CONFIG.robot(name)
    status = SimpleNamespace(position_m=tuple(position), stamp_s=stamp_s, phase=int(Phase.EXPLORING))
    link: Any = SimpleNamespace(peer_status=lambda _peer: status)
    sensing = Sensing(settings, VoxelMap())
    nothing: Any = None
    return Team(CONFIG, name, nothing, sensing, cast("Any", link), nothing, nothing)


def masked_map(observer: Team, pose: Pose, body: Body, now_s: float, model: str) -> VoxelMap:
    voxel_map, simulator = VoxelMap(), lidar(model)
    sensor = observer.sensing.sensor_pose(pose)
    for step in range(5):
        scan = simulator.scan(sensor, 0.1 * step, [body])[0]
        add(voxel_map, observer.without_peers(scan, pose, now_s), sensor)
    return voxel_map


def test_peer_mask_keeps_a_flying_peer_out_of_the_map():
    place, flyer = np.array([3.0, 0.3, 1.4]), CONFIG.robot("aerial")
    observer, pose = team("ground", place, 9.9), Pose.from_rpy(np.zeros(3), yaw_rad=0.2)
    body = (Pose.from_rpy(place, yaw_rad=0.5), flyer.size_m)
    assert hanging(masked_map(observer, pose, body, 10.0, "vlp-16")) == 0
    assert hanging(masked_map(observer, pose, body, 30.0, "vlp-16")) > 0  # the beacon is too old: no mask


def test_carrier_mask_keeps_the_carrier_out_of_the_map_of_its_rider():
    ground = Pose.from_rpy(np.array([1.0, 0.2, 0.0]), yaw_rad=0.6)
    centre = Pose.from_rpy(ground.position + np.array([0, 0, WALKER_M[2] / 2]), yaw_rad=0.6)
    observer = team("aerial", ground.position, 0.0)
    rider = carried_pose(ground, WALKER_M[2], BracketSettings())
    assert hanging(masked_map(observer, rider, (centre, WALKER_M), 0.0, "os0-64")) == 0
    away = Pose.from_rpy(ground.position + np.array([2.5, 0.3, 1.3]))
    assert hanging(masked_map(observer, away, (centre, WALKER_M), 0.0, "os0-64")) == 0
    blind = team("aerial", ground.position + np.array([9.0, 0, 0]), 0.0)
    assert hanging(masked_map(blind, away, (centre, WALKER_M), 0.0, "os0-64")) > 0


def test_shared_keyframe_never_clears_own_surfaces_nor_what_touches_them():
    """A peer saw the corridor without the obstacle that stands in it now: its free space must not win."""
    obstacle: Body = (Pose.from_rpy(np.array([4.0, 0.2, 0.5]), yaw_rad=0.3), (0.6, 0.6, 1.0))
    sensor, simulator, voxel_map = Pose.from_rpy(np.array([0.0, 0.0, 0.9])), lidar("os0-64"), VoxelMap()
    for step in range(5):
        add(voxel_map, simulator.scan(sensor, 0.1 * step, [obstacle])[0], sensor)
    before = set(map(tuple, voxel_map.occupied_indices().tolist()))
    assert hanging(voxel_map) > 10
    sensing = Sensing(CONFIG.robot("ground"), voxel_map)
    for step in range(12):
        place = Pose.from_rpy(np.array([2.0 + 0.4 * step, -0.4, 1.1]), yaw_rad=0.5 * step)
        scan = lidar("os0-64", seed=step).scan(place, 1.0 + step)[0]
        keyframe = sensing.decoded(encode(scan, place))
        assert keyframe is not None
        sensing.receive(keyframe, keyframe.pose)
    after = set(map(tuple, voxel_map.occupied_indices().tolist()))
    assert before <= after
    lost = VoxelMap()
    for step in range(5):
        add(lost, simulator.scan(sensor, 0.1 * step, [obstacle])[0], sensor)
    for step in range(12):
        place = Pose.from_rpy(np.array([2.0 + 0.4 * step, -0.4, 1.1]), yaw_rad=0.5 * step)
        add(lost, lidar("os0-64", seed=step).scan(place, 1.0 + step)[0], place)
    assert hanging(lost) < hanging(voxel_map)  # own scans of the empty corridor do clear
