"""The configuration refuses whatever is out of bounds and says which file, key and value."""

from __future__ import annotations

import copy
import math
import re
from pathlib import Path
from typing import Any

import pytest
from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel, ValidationError

from onboard.core.config import Config, RobotSettings, load_config, parse_config
from onboard.core.errors import ConfigError, InputError

SHIPPED = Path(__file__).parents[2] / "config" / "sim" / "team.toml"


def robot(name: str = "ground", number: int = 1, kind: str = "ground") -> dict[str, Any]:
    return {
        "name": name,
        "id": number,
        "kind": kind,
        "size_m": [0.9, 0.5, 0.8],
        "speed_m_s": 0.7,
        "yaw_rate_rad_s": 0.8,
        "acceleration_m_s2": 0.8,
        "lidar": {"model": "vlp-16", "mount_m": [0, 0, 0.7]},
        "keyframes": {"translation_m": 2.0},
        "planner": {},
    }


def team() -> dict[str, Any]:
    sections: dict[str, Any] = {"mission": {}, "map": {}, "deployment": {}, "bracket": {}, "radio": {}}
    return {**sections, "robots": [robot()]}


def changed(path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """A valid configuration with one value replaced."""
    data = copy.deepcopy(team())
    place: Any = data
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    return data


def sections(model: type[BaseModel], path: tuple[str | int, ...]) -> list[tuple[tuple[str | int, ...], Any]]:
    """Every (path, field) of the schema below `model`; the list of robots is entered at its first one."""
    found: list[tuple[tuple[str | int, ...], Any]] = []
    for name, field in model.model_fields.items():
        kind = field.annotation
        if name == "robots":
            found += sections(RobotSettings, ("robots", 0))
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            found += sections(kind, (*path, name))
        else:
            found.append(((*path, name), field))
    return found


def beyond(field: Any) -> list[Any]:
    """Values just outside of the bounds of a field."""
    values: list[Any] = []
    whole = field.annotation is int
    for bound in field.metadata:
        match bound:
            case Gt(gt=limit):
                values += [limit, limit - 1]
            case Ge(ge=limit):
                values.append(limit - 1 if whole else math.nextafter(limit, -math.inf))
            case Le(le=limit):
                values.append(limit + 1 if whole else math.nextafter(limit, math.inf))
            case Lt(lt=limit):
                values.append(limit)
            case MinLen(min_length=limit):
                values.append("x" * (limit - 1))
            case MaxLen(max_length=limit):
                values.append("x" * (limit + 1))
    return values


FIELDS = sections(Config, ())
OUTSIDE = [(path, value) for path, field in FIELDS for value in beyond(field)]


def test_every_number_of_the_schema_is_bounded():
    open_ended = {
        path[-1] for path, field in FIELDS if field.annotation in (int, float) and not beyond(field)
    }
    assert open_ended == set()
    assert len(OUTSIDE) >= 40


@pytest.mark.parametrize(("path", "value"), OUTSIDE, ids=lambda v: str(v)[-40:])
def test_values_beyond_a_bound_name_file_key_value_and_bound(path, value):
    with pytest.raises(ConfigError) as refused:
        parse_config(changed(path, value), "some/team.toml")
    message = str(refused.value)
    assert message.startswith("some/team.toml: ")
    assert f"{'.'.join(map(str, path))} = {value!r}: " in message
    assert "should" in message


@pytest.mark.parametrize("path", [path for path, field in FIELDS if field.annotation in (int, float)])
@pytest.mark.parametrize("value", ["fast", None, [1.0]])
def test_values_of_the_wrong_type_are_refused(path, value):
    with pytest.raises(ConfigError, match=str(path[-1])):
        parse_config(changed(path, value), "t")


@pytest.mark.parametrize("value", [math.nan, -math.inf])
@pytest.mark.parametrize("path", [path for path, field in FIELDS if field.annotation is float])
def test_numbers_that_are_none_are_refused(path, value):
    with pytest.raises(ConfigError, match=str(path[-1])):
        parse_config(changed(path, value), "t")


@pytest.mark.parametrize(
    "path",
    [
        ("colour",),
        ("mission", "duraton_s"),
        ("map", "voxels"),
        ("radio", "power_w"),
        ("deployment", "alpha"),
        ("robots", 0, "sped_m_s"),
        ("robots", 0, "lidar", "range_m"),
        ("robots", 0, "planner", "gain"),
        ("robots", 0, "keyframes", "step"),
    ],
)
def test_unknown_keys_are_an_error(path):
    with pytest.raises(ConfigError, match=rf"t: {'.'.join(map(str, path))} = 3: .*not permitted"):
        parse_config(changed(path, 3), "t")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("robots", 0, "kind"), "submarine"),
        (("robots", 0, "lidar", "model"), "hdl-64"),
        (("deployment", "rule"), "vote"),
        (("robots", 0, "size_m"), [1.0, 2.0]),
    ],
)
def test_choices_and_vectors_are_checked(path, value):
    with pytest.raises(ConfigError, match=str(path[-1])):
        parse_config(changed(path, value), "t")


def test_missing_keys_are_named():
    data = team()
    del data["robots"][0]["speed_m_s"]
    with pytest.raises(ConfigError, match=r"robots\.0\.speed_m_s"):
        parse_config(data, "t")
    with pytest.raises(ConfigError, match="robots"):
        parse_config({"robots": []}, "t")


def test_every_problem_gets_its_line():
    data = changed(("map", "voxel_m"), 9.0)
    data["radio"]["loss"] = -1.0
    with pytest.raises(ConfigError) as refused:
        parse_config(data, "t")
    assert len(str(refused.value).splitlines()) == 2


@pytest.mark.parametrize("second", [robot("ground", 2), robot("other", 1)])
def test_names_and_numbers_must_differ(second):
    data = team()
    data["robots"].append(second)
    with pytest.raises(ConfigError, match="names and ids must differ"):
        parse_config(data, "t")


def test_the_shipped_team_is_valid_and_complete():
    config = load_config(SHIPPED)
    assert [r.kind for r in config.robots] == ["ground", "aerial"]
    assert config.robot("aerial").lidar.model == "os0-64"
    assert config.robot("ground").keyframes.translation_m == 2.0
    with pytest.raises(ConfigError, match="no robot 'boat'; the team is ground, aerial"):
        config.robot("boat")


def test_a_loaded_configuration_never_changes():
    config = load_config(SHIPPED)
    with pytest.raises(ValidationError):
        config.mission.duration_s = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(("content", "why"), [(b"a = [", "not valid TOML"), (b"\xff\xfe", "not valid TOML")])
def test_broken_files_are_named(tmp_path, content, why):
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=rf"broken\.toml: {why}"):
        load_config(path)


def test_a_missing_file_is_an_input_error_that_names_it(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: no such configuration file"):
        load_config(tmp_path / "none.toml")


def with_keyframes(**settings):
    data = team()
    data["robots"][0]["keyframes"] = {"translation_m": 2.0, **settings}
    return parse_config(data, "t").robots[0].keyframes


def test_keyframes_are_coded_by_the_codec_itself_unless_told_otherwise():
    plain = with_keyframes()
    assert (plain.codec, plain.budget_bytes, plain.quality) == ("auto", None, None)
    told = with_keyframes(codec="quadtree", budget_bytes=300)
    assert (told.codec, told.budget_bytes) == ("quadtree", 300)
    assert with_keyframes(quality=2.0).quality == 2.0


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"codec": "jpeg"}, "codec = 'jpeg'"),
        ({"budget_bytes": 59}, "budget_bytes = 59"),
        ({"budget_bytes": 60_001}, "budget_bytes = 60001"),
        ({"budget_bytes": 99.5}, r"budget_bytes = 99\.5"),
        ({"quality": 0.05}, r"quality = 0\.05"),
        ({"quality": 401}, "quality = 401"),
        ({"budget_bytes": 300, "quality": 2.0}, "exclude each other"),
        ({"codec": "exact", "budget_bytes": 300}, "exact keyframes take what they take"),
        ({"codec": "exact", "quality": 1.0}, "exact keyframes take what they take"),
        ({"range_step_m": 0.1}, "range_step_m"),
    ],
)
def test_wrong_keyframe_settings_are_refused(settings, why):
    with pytest.raises(ConfigError, match=why):
        with_keyframes(**settings)


def with_lidar(**settings: Any) -> dict[str, Any]:
    data = team()
    data["robots"][0]["lidar"].update(settings)
    return data


def test_a_real_lidar_has_a_link_and_masks() -> None:
    mask = [[-0.3, -0.9], [0.3, -0.9], [0.0, -0.5]]
    link = {"ports": [7502, 7503], "sensor_host": "192.168.1.2", "metadata": "/etc/marsupial/os0.json"}
    lidar = parse_config(with_lidar(link=link, masks=[mask]), "robot.toml").robots[0].lidar
    assert lidar.link is not None
    assert (lidar.link.ports, lidar.link.address) == ((7502, 7503), "0.0.0.0")
    assert lidar.link.metadata == Path("/etc/marsupial/os0.json")
    assert lidar.masks == (((-0.3, -0.9), (0.3, -0.9), (0.0, -0.5)),)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"link": {"ports": []}}, "link.ports"),
        ({"link": {"ports": [0]}}, "link.ports.0"),
        ({"link": {"ports": [70_000]}}, "link.ports.0"),
        ({"link": {"ports": [2368], "buffer_bytes": 1}}, "link.buffer_bytes"),
        ({"masks": [[[0.0, 0.0], [1.0, 0.0]]]}, "masks.0"),
        ({"masks": [[[0.0, 0.0], [1.0, 0.0], [0.0, 90.0]]]}, "masks.0.2.1"),
    ],
)
def test_wrong_links_and_masks_are_refused(settings: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=rf"robots\.0\.lidar\.{re.escape(key)} ="):
        parse_config(with_lidar(**settings), "robot.toml")
