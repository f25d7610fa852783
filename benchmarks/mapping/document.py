"""The measured part of docs/mapping.md."""

from __future__ import annotations

from pathlib import Path

from onboard.core.errors import InputError

PAGE = "mapping.md"
_BEGIN, _END = "<!-- measured: begin -->", "<!-- measured: end -->"


def renew(page: Path, text: str) -> None:
    """Replace what stands between the page's marks. Raises InputError for a page without them."""
    try:
        before, rest = page.read_text(encoding="utf-8").split(_BEGIN)
        _, after = rest.split(_END)
    except (OSError, ValueError) as error:
        raise InputError(f"{page}: needs '{_BEGIN}' and '{_END}' once each") from error
    page.write_text(f"{before}{_BEGIN}\n{text}\n{_END}{after}", encoding="utf-8")
