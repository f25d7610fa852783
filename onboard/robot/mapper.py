"""What a robot draws into its map: its own scans, and its peers' keyframes where those say they were."""

from __future__ import annotations

import numpy as np

from onboard.core.geometry import Pose
from onboard.core.lidar import Scan
from onboard.mission import ABOARD, Phase
from onboard.planning.local_graph import FloatArray
from onboard.planning.relocation import relocate
from onboard.robot.corrections import from_message, to_message
from onboard.robot.map_frame import Moves, Told
from onboard.robot.roles import Team
from onboard.sharing.correction_talk import CorrectionTalk
from onboard.sharing.messages import Corrections


class Mapper:
    """Keeps map, keyframes and frame of one robot in step."""

    def __init__(self, team: Team) -> None:
        self._team = team
        self._talk = CorrectionTalk(team.settings.id)

    def draw(self, scan: Scan, told: Told, phase: Phase) -> None:
        """An own scan from which the other robots' bodies have been taken out."""
        team, pose = self._team, self._team.frame.pose(told)
        team.profile.timed("map", team.sensing.integrate, scan, pose)
        if phase in ABOARD:
            return
        sequence = self._keyframe(scan, pose) if team.sensing.keyframe_due(scan, pose) else None
        team.profile.timed("poses", self._team.frame.scan, scan, told, sequence)

    def _keyframe(self, scan: Scan, pose: Pose) -> int:
        team = self._team
        payload, position = team.profile.timed("encode", team.sensing.make_keyframe, scan, pose)
        team.keyframe_positions.append(position)
        team.keyframe_bytes += len(payload)
        return team.link.add_keyframe(scan.stamp_s, payload)

    def receive(self) -> None:
        """Draw what keyframes have come."""
        places: list[FloatArray] = []
        for source, sequence, payload in self._team.link.take_keyframes():
            keyframe = self._team.profile.timed("decode", self._team.sensing.decoded, payload)
            if keyframe is not None:
                pose = self._team.frame.peer((source, sequence), keyframe)
                self._team.sensing.receive(keyframe, pose)
                places.append(pose.position)
        self._team.remember_trail(places)

    def came(self, source: int, message: Corrections) -> None:
        """A peer's word on where its keyframes are, or that it knows of ours."""
        if message.knots:
            self._team.frame.take(from_message(message))
        answer = self._talk.came(source, message)
        if answer is not None:
            self._team.link.post(answer, source)

    def step(self, now_s: float) -> Moves | None:
        """Let map and poses follow closed loops; not None where the map is another one from now on."""
        team = self._team
        moves: Moves | None = team.profile.timed("poses", self._team.frame.step, team.explorer.map)
        if moves is not None:
            relocate(team.explorer, moves)
            self._talk.tell(to_message(moves.correction))
            far_m = max(float(np.linalg.norm(a.position - b.position)) for a, b in moves.pairs)
            team.log("map_redrawn", revision=moves.correction.revision, moved_m=round(far_m, 3))
        for peer in team.peer_ids:
            message = self._talk.due(now_s, peer) if team.link.in_contact(peer, now_s) else None
            if message is not None:
                team.link.post(message, peer)
        return moves
