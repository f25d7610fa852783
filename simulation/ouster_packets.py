"""Range images as the UDP packets that an OS0-64 would send for them, with metadata to match."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from onboard.core.lidar import OS0_64, LidarModel, Scan
from simulation.velodyne_packets import TimedPacket

Profile = Literal["RNG15_RFL8_NIR8", "RNG19_RFL8_SIG16_NIR16"]
RANGE_STEP_MM = {"RNG15_RFL8_NIR8": 8, "RNG19_RFL8_SIG16_NIR16": 1}
FARTHEST_MM = {"RNG15_RFL8_NIR8": 32_767 * 8, "RNG19_RFL8_SIG16_NIR16": (1 << 19) - 1}
SWEEP_S = 0.1
GRAVITY_M_S2 = 9.80665
FRAME_NUMBERS = 1 << 16
SERIAL, INITIALISATION = 992_137_000_142, 9_599_938
IMU_WORDS = 6


class SimulatedOuster:
    """A sensor whose beams are those of the nominal model: `info` is its metadata (ouster SensorInfo).

    The beams start at the optical centre and look at the centres of the image's columns.
    """

    def __init__(self, profile: Profile = "RNG15_RFL8_NIR8", model: LidarModel = OS0_64) -> None:
        from ouster.sdk import core  # noqa: PLC0415  # an extra: a simulation may do without wire formats

        self._core = core
        self._profile = profile
        self.model = model
        self.info = core.SensorInfo(_described(core, profile, model).to_json_string())
        self._format = core.PacketFormat(self.info)
        self._frame_number = 0

    def metadata(self) -> str:
        """What the sensor's HTTP API would answer."""
        return str(self.info.to_json_string())

    def packets(self, scan: Scan, begin_s: float, initialisation: int = INITIALISATION) -> list[TimedPacket]:
        """The LiDAR packets of one frame that begins at `begin_s` on the sensor's clock.

        Ranges are rounded to the profile's step; what says nothing, gave no return or is too far is 0.
        """
        self._frame_number = (self._frame_number + 1) % FRAME_NUMBERS
        columns = self.model.columns
        step_mm = RANGE_STEP_MM[self._profile]
        mm = np.round(np.where(np.isfinite(scan.ranges), scan.ranges, 0.0) * (1000 / step_mm)) * step_mm
        frame = self._core.LidarFrame(self.info)
        frame.field("RANGE")[:] = np.where(mm <= FARTHEST_MM[self._profile], mm, 0)[:, ::-1]
        frame.frame_id = self._frame_number
        frame.status[:] = 1
        frame.measurement_id[:] = np.arange(columns)
        times_s = begin_s + np.arange(columns) * (SWEEP_S / columns)
        frame.timestamp[:] = np.round(times_s * 1e9).astype(np.uint64)
        made = self._core.frame_to_packets(frame, self._format, initialisation, self.info.sn)
        each = columns // len(made)
        return [
            TimedPacket(float(times_s[(index + 1) * each - 1]), packet.buf.tobytes())
            for index, packet in enumerate(made)
        ]

    def imu_packet(self, device_s: float, acceleration_m_s2: Any, angular_rate_rad_s: Any) -> TimedPacket:
        """An IMU packet of the legacy layout: stamps in ns, acceleration in g, rate in deg/s, sensor axes."""
        stamps = np.full(3, round(device_s * 1e9), dtype="<u8")
        inverse = np.asarray(self.info.imu_to_sensor_transform)[:3, :3].T
        words = np.empty(IMU_WORDS, dtype="<f4")
        words[:3] = inverse @ np.asarray(acceleration_m_s2, dtype=np.float64) / GRAVITY_M_S2
        words[3:] = np.rad2deg(inverse @ np.asarray(angular_rate_rad_s, dtype=np.float64))
        return TimedPacket(device_s, stamps.tobytes() + words.tobytes())


def _described(core: Any, profile: Profile, model: LidarModel) -> Any:
    """Metadata of an Ouster with the model's beams."""
    mode = {512: core.LidarMode._512x10, 1024: core.LidarMode._1024x10}[model.columns]
    info = core.SensorInfo.from_default(mode)
    info.prod_line, info.fw_rev = "OS-0-64", "v3.1.0"
    info.sn, info.init_id = SERIAL, INITIALISATION
    info.beam_altitude_angles = list(model.elevations_deg)
    info.beam_azimuth_angles = [180.0 / model.columns] * model.rows
    info.lidar_origin_to_beam_origin_mm = 0.0
    info.beam_to_lidar_transform = np.eye(4)
    layout = info.format
    layout.udp_profile_lidar = getattr(core.UDPProfileLidar, profile)
    layout.pixel_shift_by_row = [0] * model.rows
    info.format = layout
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    info.config.udp_profile_lidar = layout.udp_profile_lidar
    return info
