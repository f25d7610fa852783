"""The one configuration schema: strict, bounded, units in the names, refused rather than repaired."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from onboard.core.errors import ConfigError

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
SlopeAngle = Annotated[float, Field(ge=0, lt=1.5)]
Ratio = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[float, float, float]
Size = tuple[Positive, Positive, Positive]
Port = Annotated[int, Field(ge=1, le=65_535)]
MaskCorner = tuple[Annotated[float, Field(ge=-6.3, le=6.3)], Annotated[float, Field(ge=-1.6, le=1.6)]]
RosName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$", max_length=200)]
"""Name of a ROS topic, service or namespace without its leading slash."""
MaskPolygon = Annotated[tuple[MaskCorner, ...], Field(min_length=3, max_length=64)]


STAIRS_M_S = 0.35
"""Of a legged base that says nothing else of itself."""


class Section(BaseModel):
    """Base of every table: unknown keys are an error and values never change after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LidarLink(Section):
    """How a real LiDAR is connected."""

    ports: Annotated[tuple[Port, ...], Field(min_length=1, max_length=4)]
    """A Velodyne's for data (2368) and position (8308), an Ouster's for LiDAR (7502) and IMU (7503)."""
    address: str = "0.0.0.0"
    """Address of the network interface to listen on; 0.0.0.0 is all of them."""
    sensor_host: str | None = None
    """The sensor's address: packets of others are ignored, and an Ouster is asked for its metadata."""
    metadata: Path | None = None
    """The Ouster's metadata file; without it the sensor is asked."""
    calibration: Path | None = None
    """A Velodyne's own calibration (YAML of velodyne_pointcloud); without it the nominal angles hold."""
    buffer_bytes: Annotated[int, Field(ge=65_536, le=67_108_864)] = 4_194_304


class LidarSettings(Section):
    """The LiDAR of one robot, how it is connected, and the noise that the simulator gives it."""

    model: Literal["vlp-16", "os0-64"]
    mount_m: Vector
    link: LidarLink | None = None
    masks: tuple[MaskPolygon, ...] = ()
    """What the robot itself covers of the view: corners (azimuth, elevation) in radians, sensor frame."""
    rate_hz: Positive = 2.0
    noise_std_m: NonNegative = 0.02
    dropout: Ratio = 0.02


class KeyframeSettings(Section):
    """When a scan becomes a keyframe (tau_t, tau_r), and how it is coded (docs/codec.md)."""

    translation_m: Positive
    rotation_rad: Positive = 0.785
    codec: Literal["auto", "quadtree", "exact"] = "auto"
    budget_bytes: Annotated[int, Field(ge=60, le=60_000)] | None = None
    quality: Annotated[float, Field(ge=0.1, le=400.0)] | None = None

    @model_validator(mode="after")
    def _one_way_to_set_the_size(self) -> Self:
        if self.budget_bytes is not None and self.quality is not None:
            raise ValueError("budget_bytes and quality exclude each other: give one of them")
        if self.codec == "exact" and (self.budget_bytes is not None or self.quality is not None):
            raise ValueError("exact keyframes take what they take: leave out budget_bytes and quality")
        return self


class MapSettings(Section):
    """The voxel map of every robot."""

    voxel_m: Annotated[float, Field(ge=0.05, le=1.0)] = 0.2
    max_range_m: Positive = 20.0


class PlannerSettings(Section):
    """Local and global planning of one robot; the symbols are those of docs/planner.md."""

    window_m: Size = (30.0, 30.0, 8.0)
    vertices: Annotated[int, Field(ge=20, le=5000)] = 700
    edge_max_m: Positive = 3.0
    clearance_m: NonNegative = 0.15
    gain_range_m: Positive = 20.0
    gain_vertices: Annotated[int, Field(ge=5, le=2000)] = 150
    occlusion_rate_per_m: NonNegative = 0.4
    direction_weight: NonNegative = 2.0
    start_up_s: Positive = 3.0
    frontier_m3: Positive = 1.5
    horizon_m: Positive = 8.0
    replan_s: Positive = 4.0
    switch_gain: Annotated[float, Field(ge=1)] = 1.15
    home_margin_s: NonNegative = 8.0
    home_margin_ratio: Ratio = 0.05


class BaseLink(Section):
    """How a legged base is driven: ROS 2 messages over zenoh (docs/base.md)."""

    bridge: Literal["ros2dds", "rmw_zenoh"]
    """What runs on the base: zenoh-bridge-ros2dds beside a DDS, or ROS 2 on rmw_zenoh itself."""
    mode: Literal["client", "peer"] = "client"
    connect: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    listen: tuple[str, ...] = ()
    domain: Annotated[int, Field(ge=0, le=232)] = 0
    """ROS_DOMAIN_ID of the base; part of the keys of rmw_zenoh only."""
    type_hashes: bool = True
    """Whether the base's ROS 2 has them: all but Humble; part of the keys of rmw_zenoh only."""
    namespace: RosName | Literal[""] = ""
    command_topic: RosName = "cmd_vel"
    command_type: Literal["TwistStamped", "Twist"] = "TwistStamped"
    odometry_topic: RosName = "odom"
    sit_service: RosName = "sit"
    stand_service: RosName = "stand"
    frame: str = "base_link"
    rate_hz: Annotated[float, Field(ge=5, le=100)] = 20.0
    """Commands a second; a base stops by itself when they cease."""
    stairs_speed_m_s: Positive = STAIRS_M_S
    """On ground as steep as stairs, up and down."""
    settle_s: NonNegative = 3.0
    """After the base has agreed to stand up or to sit down, until it has."""


class RobotSettings(Section):
    """One member of the team: body, motion, sensor, planner."""

    name: Annotated[str, Field(min_length=1, max_length=16)]
    id: Annotated[int, Field(ge=0, le=255)]
    kind: Literal["ground", "aerial"]
    size_m: Size
    speed_m_s: Positive
    yaw_rate_rad_s: Positive
    acceleration_m_s2: Positive
    lidar: LidarSettings
    keyframes: KeyframeSettings
    planner: PlannerSettings = PlannerSettings()
    base: BaseLink | None = None
    step_max_m: NonNegative = 0.25
    slope_max_rad: SlopeAngle = 0.5236
    slope_down_max_rad: SlopeAngle | None = None
    stairs_max_rad: SlopeAngle = 0.6109
    roll_max_rad: SlopeAngle = 0.3491
    battery_wh: Positive = 1000.0
    hover_power_w: Positive = 100.0
    reserve: Ratio = 0.2

    @property
    def stairs_speed_m_s(self) -> float:
        """Speed on ground as steep as stairs; one that flies does not slow down."""
        if self.kind == "aerial":
            return self.speed_m_s
        return STAIRS_M_S if self.base is None else self.base.stairs_speed_m_s


class DeploymentSettings(Section):
    """When the carrier releases (the trigger) and what it sends along."""

    rule: Literal["rate", "paper"] = "rate"
    gamma: NonNegative = 0.7
    min_rate_m3_s: Positive = 0.05
    min_volume_m3: Positive = 50.0
    debounce_cycles: Annotated[int, Field(ge=1)] = 3
    hysteresis: NonNegative = 0.2
    min_battery: Ratio = 0.6
    launch_s: Positive = 30.0
    keyframes_sent: Annotated[int, Field(ge=1)] = 300
    overhead_clearance_m: Positive = 0.8
    colocalise: bool = False
    """The bracket opens only once the robot aboard has told that it found itself in the carrier's map."""


class BracketSettings(Section):
    """Where a carrier holds its aerial robots: the initial guess of the co-localisation."""

    height_m: Positive = 0.15
    """From the carrier's back to the carried body's centre."""
    spacing_m: Positive = 0.45
    """Between places along the back; the first is in the middle, the second before it, the third behind."""
    yaw_rad: Annotated[float, Field(ge=-3.1416, le=3.1416)] = 0.0
    """Of the carried body against the carrier's."""


class RadioSettings(Section):
    """The simulated radio between the robots."""

    range_m: Positive = 50.0
    wall_loss_db: NonNegative = 0.0
    rate_bytes_s: Positive = 150_000.0
    latency_s: NonNegative = 0.02
    loss: Ratio = 0.01


class MissionSettings(Section):
    """The clock of the mission and the regrouping rules."""

    duration_s: Positive = 900.0
    area_m: tuple[Vector, Vector] | None = None
    """Lower and upper corner of the box to explore: nobody flies out of it or gains from what is outside."""
    regroup_radius_m: Positive = 3.0
    contact_timeout_s: Positive = 3.0
    regroup_period_s: Positive = 15.0

    @field_validator("area_m")
    @classmethod
    def _not_inside_out(cls, area: tuple[Vector, Vector] | None) -> tuple[Vector, Vector] | None:
        if area is not None and any(low >= high for low, high in zip(*area, strict=True)):
            raise ValueError("each lower coordinate must be below the upper one")
        return area


class Config(Section):
    """Everything a mission needs to know."""

    mission: MissionSettings = MissionSettings()
    map: MapSettings = MapSettings()
    deployment: DeploymentSettings = DeploymentSettings()
    bracket: BracketSettings = BracketSettings()
    radio: RadioSettings = RadioSettings()
    robots: Annotated[tuple[RobotSettings, ...], Field(min_length=1)]

    def carries(self, robot: RobotSettings) -> bool:
        """Whether somebody in the team carries this robot at first."""
        return robot.kind == "aerial" and any(other.kind == "ground" for other in self.robots)

    def robot(self, name: str) -> RobotSettings:
        """The robot called `name`. Raises ConfigError for an unknown one."""
        for robot in self.robots:
            if robot.name == name:
                return robot
        raise ConfigError(f"no robot '{name}'; the team is {', '.join(r.name for r in self.robots)}")


def load_config(path: Path) -> Config:
    """Read a TOML file. Raises ConfigError with file, key, value and bound for anything wrong."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such configuration file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
    return parse_config(data, str(path))


def parse_config(data: dict[str, Any], origin: str) -> Config:
    """Validate plain data; `origin` names it in messages. Raises ConfigError."""
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(origin, problem) for problem in error.errors())) from error
    ids = [robot.id for robot in config.robots]
    names = [robot.name for robot in config.robots]
    if len(set(ids)) < len(ids) or len(set(names)) < len(names):
        raise ConfigError(f"{origin}: robots: names and ids must differ, got {names} {ids}")
    return config


def _explain(origin: str, problem: Any) -> str:
    key = ".".join(str(part) for part in problem["loc"])
    return f"{origin}: {key} = {problem.get('input')!r}: {problem['msg']}"
