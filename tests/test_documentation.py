"""The documentation against the code: configuration keys with defaults, links, markers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from onboard.core.config import BaseLink, Config, RobotSettings

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)#]+)(?:#[^)]*)?\)")


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names of all values with their defaults; robots are those of one robot."""
    for name, field in model.model_fields.items():
        kind = RobotSettings if name == "robots" else field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from keys(kind, f"{prefix}{name}.")
        else:
            yield prefix + name, field.default


def shown(default: Any) -> str:
    """A default as the table writes it."""
    if default is PydanticUndefined:
        return "-"
    if default is None:
        return "none"
    if isinstance(default, tuple):
        return ", ".join(map(str, default))
    return f'"{default}"' if isinstance(default, str) else str(default)


def table() -> dict[str, str]:
    """Key to default of the table in planner.md."""
    rows = re.findall(r"^\| `([a-z0-9_.]+)` \|[^|]*\|([^|]*)\|", (ROOT / "docs/planner.md").read_text(), re.M)
    return {key: default.strip() for key, default in rows}


def test_every_configuration_key_is_documented_with_its_default() -> None:
    assert table() == {key: shown(default) for key, default in keys(Config)}


def test_every_key_of_the_base_is_documented() -> None:
    first_column = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", (ROOT / "docs/base.md").read_text(), re.M)
    assert set(re.findall(r"\w+", " ".join(first_column))) == set(BaseLink.model_fields)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    local = [link for link in LINK.findall(page.read_text()) if "://" not in link]
    assert [link for link in local if not (page.parent / link).exists()] == []


def test_readme_has_the_headline_markers() -> None:
    text = (ROOT / "README.md").read_text()
    assert text.index("<!-- headline:begin -->") < text.index("<!-- headline:end -->")


def test_planner_has_the_sections_that_the_sources_cite() -> None:
    text = (ROOT / "docs/planner.md").read_text()
    headings = set(re.findall(r"^### (\d\.\d) ", text, re.M))
    sources = [path.read_text() for path in (ROOT / "onboard").rglob("*.py")]
    cited = {number for source in sources for number in re.findall(r"planner\.md (\d\.\d)", source)}
    assert cited
    assert cited <= headings
