"""What the safety gates judge: commands, what is known when they are judged, and limits.

A fact that is not known is None, and None never allows.
"""

from __future__ import annotations

from dataclasses import dataclass

from onboard.mission import Phase

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Where an aerial robot shall be at `stamp_s`: metres, m/s and m/s2 in `frame`, yaw in rad and rad/s."""

    stamp_s: float
    frame: str
    position: Vector
    velocity: Vector
    acceleration: Vector
    yaw: float
    yaw_rate: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightLimits:
    """What no setpoint exceeds. The fence is a box (x and y), altitude is z in the map frame."""

    speed_m_s: float
    acceleration_m_s2: float
    yaw_rate_rad_s: float
    fence_x_m: tuple[float, float]
    fence_y_m: tuple[float, float]
    altitude_m: tuple[float, float]
    clearance_m: float
    """Smallest distance of a setpoint to what is occupied."""
    lead_m: float
    """Largest distance of a setpoint to where the robot is: a jump of the pose or of the plan is refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFacts:
    """What is known when a setpoint is judged."""

    now_s: float
    position: Vector | None = None
    pose_stamp_s: float | None = None
    clearance_m: float | None = None
    """Distance of the setpoint to the nearest occupied place."""
    previous: Setpoint | None = None
    """The setpoint emitted before; None at the start of a stream and after the map frame was moved."""


@dataclass(frozen=True, slots=True)
class Token:
    """The will to release one robot: the operator's or the deployment trigger's, good for TOKEN_S."""

    source: str
    robot: int
    stamp_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ReleaseFacts:
    """What is known when the bracket shall open; a default never allows."""

    now_s: float
    robot: int | None = None
    """Id of the robot in the bracket."""
    token: Token | None = None
    phase: Phase | None = None
    still_since_s: float | None = None
    base_stamp_s: float | None = None
    tilt_rad: float | None = None
    aerial_ready: bool | None = None
    """Armed and self-tested, says the aerial robot."""
    aerial_stamp_s: float | None = None
    colocalised: bool | None = None
    bracket: str | None = None
    """State that the bracket reports."""
    bracket_stamp_s: float | None = None
    """When the bracket's last good heartbeat came."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TakeOffFacts:
    """What is known when an aerial robot wants to leave its carrier; a default never allows."""

    now_s: float
    phase: Phase | None = None
    bracket_open: bool | None = None
    """The carrier says that its bracket is open."""
    carrier_still: bool | None = None
    carrier_stamp_s: float | None = None
    """When the carrier said so."""
    pose_stamp_s: float | None = None
    tilt_rad: float | None = None
    colocalised: bool | None = None
    vehicle_ready: bool | None = None
    """The autopilot's own checks have passed."""
    vehicle_stamp_s: float | None = None
    """When the autopilot's last heartbeat came."""
    charge: float | None = None
    """Battery, 0 to 1."""
    charge_needed: float | None = None
    overhead_m: float | None = None
    """How far up it is known to be free."""
    climb_m: float | None = None
    """How far up the robot wants to go."""


@dataclass(frozen=True, slots=True)
class BaseCommand:
    """Velocity that the base shall have, made at `stamp_s`, in `frame`: m/s forward and left, rad/s."""

    stamp_s: float
    frame: str
    forward_m_s: float
    left_m_s: float
    yaw_rate: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseLimits:
    """What no command to the base exceeds."""

    speed_m_s: float
    yaw_rate_rad_s: float
    tilt_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseFacts:
    """What is known when a command to the base is judged; a default never allows."""

    now_s: float
    phase: Phase | None = None
    odometry_stamp_s: float | None = None
    tilt_rad: float | None = None
    bracket: str | None = None
    """State that the bracket reports; NO_BRACKET on a robot that has none."""
    bracket_empty: bool | None = None
    """The robot that it held has left: then the bracket's state does not matter any more."""
    departed: bool | None = None
    """No released robot is still close to its carrier."""
